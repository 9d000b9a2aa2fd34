"""A floor plan: the drawing and its walls as rasters in the frame of a site."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fploc.errors import BadFileError, MissingFileError
from fploc.floorplan.georeference import Georeference

Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# Walls are stored as an image: 0 wall, 255 free.
_WALL, _FREE = 0, 255


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """A plan drawn in the frame of a site.

    Args:
        name: Name of the site whose plan it is.
        grey: The drawing, shape (H, W), uint8: 255 free, darker where a line is drawn.
        walls: True where there is a wall, shape (H, W).
        georeference: Metres of the site frame to pixels of both rasters.
    """

    name: str
    grey: Grey
    walls: Mask
    georeference: Georeference

    def write(self, grey_path: Path, walls_path: Path) -> None:
        """Write both rasters as PNG files (walls: 0 wall, 255 free)."""
        write_grey_image(grey_path, self.grey)
        write_grey_image(walls_path, np.where(self.walls, _WALL, _FREE).astype(np.uint8))

    def blank(self) -> FloorPlan:
        """Return the same sheet with nothing drawn on it: what an image adds is measured against it."""
        return replace(
            self,
            name=f"{self.name}, blank",
            grey=np.full_like(self.grey, _FREE),
            walls=np.zeros_like(self.walls),
        )

    def placed_as(self, other: FloorPlan) -> FloorPlan:
        """Return this drawing in the place of ``other``, top-left corner on top-left corner, scale kept."""
        corner_m = other.georeference.to_metres([-0.5, -0.5])
        metres_per_pixel = 1.0 / self.georeference.pixels_per_metre
        return replace(self, georeference=Georeference.of_raster(corner_m, metres_per_pixel))


def read_grey_image(path: Path) -> Grey:
    """Return an image file as shape (H, W), uint8, grey.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If it is no image.
    """
    if not path.is_file():
        raise MissingFileError(path, expected="an image of a floor plan", way_out="check the path")
    # A file name goes through the C library's own encoding; bytes read here do not.
    encoded = np.fromfile(path, dtype=np.uint8)
    try:
        image = cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE) if encoded.size else None
    except cv2.error:
        # Raised, for example, of a header that promises more pixels than OpenCV accepts.
        image = None
    if image is None:
        raise BadFileError(
            path,
            "whole file",
            value=f"{path.stat().st_size} bytes that do not decode",
            expected="a PNG or JPEG image",
            way_out="export the plan as PNG, or fetch the file again",
        )
    return np.asarray(image, dtype=np.uint8)


def read_floor_plan(grey_path: Path, walls_path: Path, georeference: Georeference, name: str) -> FloorPlan:
    """Read what ``FloorPlan.write`` wrote.

    Raises:
        MissingFileError: If one of the files is missing.
        BadFileError: If one is no image, or the two differ in size.
    """
    grey, walls = read_grey_image(grey_path), read_grey_image(walls_path)
    if grey.shape != walls.shape:
        raise BadFileError(
            walls_path,
            "whole file",
            value=f"{walls.shape[1]} x {walls.shape[0]} pixels",
            expected=f"the size of {grey_path.name}, {grey.shape[1]} x {grey.shape[0]}",
            way_out="rebuild the packed site with `fploc data build`",
        )
    return FloorPlan(name=name, grey=grey, walls=walls < (_WALL + _FREE) / 2, georeference=georeference)


def write_grey_image(path: Path, image: Grey) -> None:
    """Write an image, shape (H, W), uint8, as PNG: under a temporary name, then renamed."""
    done, encoded = cv2.imencode(".png", image)
    assert done, "OpenCV encodes every uint8 array as PNG"
    temporary = path.with_name(f".{path.name}.partial")
    try:
        temporary.write_bytes(encoded.tobytes())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
