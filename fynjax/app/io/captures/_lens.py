"""The maker's own calibration of a lens: where its pixels lie in a frame that all bands share."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real
from scipy.ndimage import map_coordinates

from fynjax.sensors import Lens


@dataclass(frozen=True)
class Registration:
    """Distortion of a lens, and the homography from its straightened picture to the shared frame.

    Columns and rows count from the middle of the top left pixel.
    """

    homography: Float[np.ndarray, "3 3"]
    """Matrix from column and row of the straightened picture (and 1) to those of the frame."""
    lens: Lens | None = None
    """None: without distortion."""

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
