"""Where the sun stands, from place and time."""

from datetime import datetime
from typing import Any, NamedTuple

from fynjax._core.errors import InputError
from fynjax._core.extras import require

_UNITS = "degrees north and east (west is negative)"


class SunPosition(NamedTuple):
    """The sun in the sky of one place and time."""

    zenith: float
    """Apparent zenith angle, refraction included [degrees]."""
    azimuth: float
    """Clockwise from north [degrees]."""
    solar_factor: float
    """Sunlight above the air over that at one astronomical unit, 1/d² [-]."""


def sun_position(
    latitude: float, longitude: float, time: datetime | str, *, altitude: float = 0.0
) -> SunPosition:
    """Position of the sun by the algorithm of NREL (Reda and Andreas 2004), through pvlib.

    **Arguments:**

    - `latitude`: degrees north, -90 to 90.
    - `longitude`: degrees east, -180 to 180.
    - `time`: a datetime with a time zone or an ISO string with one, such as "2017-11-08T18:42:29Z".
    - `altitude`: of the ground above the sea [m], from which the refraction takes its pressure.

    **Returns:** a `SunPosition`: zenith and azimuth [degrees].

    **Raises:** `InputError` for a place that is none on earth, a time without a time zone, and a
    sun at or below the horizon; `MissingExtraError` without pvlib.

    Not differentiable.

    >>> from fynjax.sensors import sun_position
    >>> sun = sun_position(-34.5, 19.5, "2023-11-08T10:00:00Z")  # Grootbos, noon in spring
    >>> round(float(sun.zenith), 1), round(float(sun.azimuth), 1)
    (18.8, 19.4)
    """
    for name, value, limit in (("latitude", latitude, 90.0), ("longitude", longitude, 180.0)):
        if not abs(value) <= limit:
            raise InputError(
                f"`{name}` must be in {-limit:g} to {limit:g} degrees, but is {value:g}: "
                f"{_UNITS}, not radians or metres."
            )
    moment = _moment(time)
    pvlib: Any = require("pvlib", "analysis")
    pressure = pvlib.atmosphere.alt2pres(altitude)
    table = pvlib.solarposition.get_solarposition(
        moment, latitude, longitude, altitude=altitude, pressure=pressure
    )
    distance = float(pvlib.solarposition.nrel_earthsun_distance(moment).iloc[0])
    zenith, azimuth = (float(table[name].iloc[0]) for name in ("apparent_zenith", "azimuth"))
    if zenith >= 90.0:
        raise InputError(
            f"the sun must be above the horizon, but is {zenith - 90.0:.1f} degrees below it at "
            f"latitude {latitude:g}, longitude {longitude:g}, {moment[0].isoformat()}: is the time "
            f"in the time zone given, and is the place in {_UNITS}?"
        )
    return SunPosition(zenith, azimuth, distance**-2)


def _moment(time: datetime | str) -> Any:
    import pandas as pd

    try:
        moment = pd.Timestamp(time)
    except (ValueError, TypeError) as error:
        raise InputError(
            f"`time` must be a date and time such as '2017-11-08T18:42:29Z', but is {time!r}."
        ) from error
    if moment.tzinfo is None:
        raise InputError(
            f"`time` must have a time zone, but {time!r} has none: add 'Z' for UTC, or an offset "
            "such as '+02:00'."
        )
    return pd.DatetimeIndex([moment.tz_convert("UTC")])
