"""How plants are turned and lean, and where the elements of a turned and leaning plant lie."""

from typing import Any

import numpy as np
from jaxtyping import Float

from fynjax._core.seeds import generator


def random_orientation(
    n: int, *, seed: int, rotation_spread: float = 0.0
) -> tuple[Float[np.ndarray, " plant"], Float[np.ndarray, " plant"]]:
    """Azimuth and tilt of plants [degrees], for `unit_shapes`.

    **Arguments:**

    - `n`: number of plants.
    - `seed`: the same seed gives the same plants the same orientation, however many there are.
    - `rotation_spread`: standard deviation sigma_rot of the tilts [degrees], at least 0.

    **Returns:** azimuths, uniform in [0, 360), and tilts, the sizes of normal numbers with the
    standard deviation `rotation_spread`, at most 90. NumPy arrays; the tilts are linear in
    `rotation_spread` up to that limit.
    """
    azimuth = 360.0 * generator(seed, 0).random(n)
    tilt = rotation_spread * np.abs(generator(seed, 1).standard_normal(n))
    return azimuth, np.minimum(tilt, 90.0)


def unit_shapes(position: Any, azimuth: Any, tilt: Any, numpy: Any = np) -> tuple[Any, Any]:
    """Turned and leaning plants of unit size: [plant, element, 3] per diameter and per height.

    An element of a plant is at site + diameter times the first array + height times the second.

    **Arguments:**

    - `position`: that of a `PlantModel`, [element, 3] or [plant, element, 3].
    - `azimuth`: turn of each plant about the vertical [degrees], clockwise from above: the model's
      north side then faces that azimuth.
    - `tilt`: lean of each plant's axis from the vertical towards its azimuth [degrees].
    - `numpy`: the library that computes, `numpy` or `jax.numpy`.

    Differentiable, with `jax.numpy`, in every array.
    """
    x, y, z = (position[..., axis] for axis in range(3))
    turn, lean = numpy.deg2rad(azimuth)[:, None], numpy.deg2rad(tilt)[:, None]
    east, north = numpy.sin(turn), numpy.cos(turn)

    def stand(right: Any, ahead: Any, up: Any) -> Any:
        shape = (turn.shape[0], position.shape[-2])
        parts = (right * north + ahead * east, ahead * north - right * east, up)
        return numpy.stack([numpy.broadcast_to(part, shape) for part in parts], axis=-1)

    # Lean about the east-west axis towards north, then turn clockwise.
    per_diameter = stand(x, y * numpy.cos(lean), -y * numpy.sin(lean))
    return per_diameter, stand(0.0 * x, z * numpy.sin(lean), z * numpy.cos(lean))
