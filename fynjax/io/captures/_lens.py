"""The maker's own calibration of a lens: where its pixels lie in a frame that all bands share."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real
from scipy.ndimage import map_coordinates


@dataclass(frozen=True)
class Lens:
    """Distortion of a lens, and the homography from its straightened picture to the shared frame.

    Columns and rows count from the middle of the top left pixel, as in OpenCV.
    """

    homography: Float[np.ndarray, "3 3"]
    """Matrix from column and row of the straightened picture (and 1) to those of the frame."""
    focal_length: tuple[float, float] = (1.0, 1.0)
    """Focal length along columns and rows [pixel]."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Column and row of the optical axis [pixel]."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Coefficients k1, k2, p1, p2, k3 [-]: radial, tangential and radial again."""

    def on_frame(self, picture: Real[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """The picture [row, column] on the pixels of the frame, interpolated once (bilinear); NaN
        where it does not reach. The lens model is that of Brown (1966), as OpenCV has it."""
        shape = picture.shape
        row, column = np.indices(shape, dtype=float)
        seen = np.linalg.inv(self.homography) @ np.stack(
            [column.ravel(), row.ravel(), np.ones(row.size)]
        )
        x, y = (
            (at / seen[2] - middle) / focal
            for at, middle, focal in zip(seen[:2], self.centre, self.focal_length, strict=True)
        )
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        away_x = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        away_y = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        place = [
            middle + focal * away
            for away, middle, focal in zip(
                (away_y, away_x), self.centre[::-1], self.focal_length[::-1], strict=True
            )
        ]
        real = np.result_type(picture, np.float32)  # whole numbers have no NaN
        return map_coordinates(picture, place, real, order=1, cval=np.nan).reshape(shape)
