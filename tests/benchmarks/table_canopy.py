"""A uniform canopy beside 4SAIL and discrete ordinates, at 180 geometries:
`python -m tests.benchmarks.table_canopy`.

Prints how far `canopy_reflectance` is from 4SAIL (with the hot spot, and without) and from 32
streams, and 4SAIL from these, in red and near infrared. The peers' numbers are stored: see
`tests/radiation/test_canopy.py`.
"""

from collections.abc import Sequence

import numpy as np

from fynjax.canopy import VerhoefLeafAngle
from tests.benchmarks._measure import options
from tests.radiation.test_canopy import FLAT, PEERS, peer, reflectances


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    options(__doc__).parse_args(arguments)  # it is tiny as it is
    hot = reflectances(VerhoefLeafAngle(-0.35, -0.15), 0.05)
    points = reflectances("spherical", 0.0)
    rows = (
        ("fynjax / 4SAIL, hspot 0.05", hot, peer("prosail")),
        ("fynjax / 4SAIL, hspot 0", points, peer("sail")),
        ("fynjax / 32 streams", points, peer("disort")),
        ("4SAIL / 32 streams", peer("sail"), peer("disort")),
    )
    columns = "mean, rms, most [%], within 1 %, in the sun's direction [%]"
    print(f"{'':28}{'band':6}{columns}")
    for name, ours, theirs in rows:
        for k, band in enumerate(("red", "nir")):
            off = 100.0 * (ours[:, k] / theirs[:, k] - 1.0)
            worst = PEERS.iloc[int(np.argmax(np.abs(off))), :3].astype(int).tolist()
            print(
                f"{name:28}{band:6}{off.mean():6.2f}{np.sqrt(np.mean(off**2)):6.2f}"
                f"{np.abs(off).max():6.2f} at {worst}{np.sum(np.abs(off) < 1):5} of {len(off)} "
                f"{np.round(off[FLAT], 2).tolist()}"
            )


if __name__ == "__main__":
    main()
