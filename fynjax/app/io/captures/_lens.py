"""The maker's own calibration of a lens: where its pixels lie in a frame that all bands share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Real
from scipy.ndimage import map_coordinates

from fynjax.sensors import Lens

_STEPS = 30
"""Of the iteration that turns distortion round; ten serve a lens that bends little."""


@dataclass(frozen=True)
class Registration:
    """Distortion of a lens, and the homography from its straightened picture to the shared frame.

    Columns and rows count from the middle of the top left pixel.
    """

    homography: Float[np.ndarray, "3 3"]
    """Matrix from column and row of the straightened picture (and 1) to those of the frame."""
    lens: Lens | None = None
    """None: without distortion."""

    def places(self, pixels: Float[Any, "*point 2"]) -> Float[np.ndarray, "*point 2"]:
        """Where columns and rows of the camera's own picture lie in the frame [pixel].

        NaN beyond what the lens has: its distortion is turned round by iteration.
        """
        straight = np.asarray(pixels, float)
        if self.lens is not None:
            centre, focal = self.lens.centre, self.lens.focal_length
            placed = (straight - centre) / focal
            sight = placed
            with np.errstate(all="ignore"):  # what diverges is no place of the picture
                for _ in range(_STEPS):
                    missed = placed - self.lens.distorted(sight)[0]
                    sight = sight + missed
                known = self.lens.distorted(sight)[1] & (np.abs(missed).max(axis=-1) < 1e-6)
            straight = np.where(known[..., None], centre + focal * sight, np.nan)
        seen = np.concatenate([straight, np.ones_like(straight[..., :1])], -1) @ self.homography.T
        return np.asarray(seen[..., :2] / seen[..., 2:])

    def on_frame(self, picture: Real[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """The picture [row, column] on the pixels of the frame, interpolated once (bilinear); NaN
        where it does not reach."""
        shape = picture.shape
        row, column = np.indices(shape, dtype=float)
        seen = np.linalg.inv(self.homography) @ np.stack(
            [column.ravel(), row.ravel(), np.ones(row.size)]
        )
        place = (seen[:2] / seen[2]).T
        if self.lens is not None:
            place = self.lens.pixels((place - self.lens.centre) / self.lens.focal_length)
        place = np.nan_to_num(place[:, ::-1].T, nan=-2.0)  # the lens has no picture of it
        real = np.result_type(picture, np.float32)  # whole numbers have no NaN
        return map_coordinates(picture, place, real, order=1, cval=np.nan).reshape(shape)
