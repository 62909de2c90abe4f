"""The simulated lens: from pixels to the rays that the machine's camera really sees along.

This is written apart from the lens of ``twinline.geometry`` on purpose, so that a mistake in one shows against the
other. The distortion is that of D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971).
"""

from dataclasses import dataclass

import numba
import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import SettingsError

_ROUNDS = 200
_TOLERANCE = 1e-13


@dataclass(frozen=True)
class Lens:
    """Intrinsic parameters of the simulated camera.

    Attributes
    ----------
    focal_px : (float, float)
        Focal lengths along u and v.
    centre_px : (float, float)
        Principal point u, v.
    radial : (float, float, float)
        Coefficients of r^2, r^4 and r^6.
    tangential : (float, float)
        Coefficients of decentring, in the order p1, p2.
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)

    def slopes(self, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
        """Rays through a grid of pixels, as x/z and y/z in the camera frame.

        Parameters
        ----------
        u_px : (columns,) array
            Columns of the grid.
        v_px : (rows,) array
            Rows of the grid.

        Returns
        -------
        (rows, columns, 2) array

        Raises
        ------
        SettingsError
            The distortion folds the image over within the grid: no ray belongs to some pixel.
        """
        bent_x = (np.asarray(u_px, dtype=np.float64) - self.centre_px[0]) / self.focal_px[0]
        bent_y = (np.asarray(v_px, dtype=np.float64) - self.centre_px[1]) / self.focal_px[1]
        slopes, failures = _straighten(bent_x, bent_y, *self.radial, *self.tangential)
        if failures:
            raise SettingsError(
                f"The simulated lens has no ray for {failures} of {slopes.shape[0] * slopes.shape[1]} pixels: "
                f"its distortion (radial {self.radial}, tangential {self.tangential}) is too strong for this image."
            )
        return slopes

    def project(self, slopes: FloatArray) -> FloatArray:
        """Pixels in which rays arrive.

        Parameters
        ----------
        slopes : (..., 2) array
            x/z and y/z in the camera frame.

        Returns
        -------
        (..., 2) array
            u, v in pixels.
        """
        slopes = np.asarray(slopes, dtype=np.float64)
        x, y = slopes[..., 0], slopes[..., 1]
        square = x**2 + y**2
        stretch = 1.0 + np.polynomial.polynomial.polyval(square, (0.0, *self.radial))
        p1, p2 = self.tangential
        bent_x = x * stretch + 2 * p1 * x * y + p2 * (square + 2 * x**2)
        bent_y = y * stretch + 2 * p2 * x * y + p1 * (square + 2 * y**2)
        return np.stack(
            [bent_x * self.focal_px[0] + self.centre_px[0], bent_y * self.focal_px[1] + self.centre_px[1]], axis=-1
        )


@numba.njit(cache=True, nogil=True)
def _straighten(
    bent_x: FloatArray, bent_y: FloatArray, k1: float, k2: float, k3: float, p1: float, p2: float
) -> tuple[FloatArray, int]:  # pragma: no cover - compiled
    """Solve ``bent = x * stretch(x) + decentring(x)`` for x by repeated substitution, grid point by grid point."""
    slopes = np.empty((bent_y.size, bent_x.size, 2))
    failures = 0
    for row in range(bent_y.size):
        for column in range(bent_x.size):
            x, y = bent_x[column], bent_y[row]
            step = np.inf
            for _ in range(_ROUNDS):
                square = x * x + y * y
                stretch = 1.0 + square * (k1 + square * (k2 + square * k3))
                if not stretch > 0.1:
                    break
                next_x = (bent_x[column] - 2.0 * p1 * x * y - p2 * (square + 2.0 * x * x)) / stretch
                next_y = (bent_y[row] - 2.0 * p2 * x * y - p1 * (square + 2.0 * y * y)) / stretch
                step = abs(next_x - x) + abs(next_y - y)
                x, y = next_x, next_y
                if step < _TOLERANCE:
                    break
            if not step < _TOLERANCE:
                failures += 1
            slopes[row, column, 0] = x
            slopes[row, column, 1] = y
    return slopes, failures
