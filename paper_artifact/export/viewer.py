"""A 3-D view in one HTML file: WebGL, the triangles inside as base64, no network, no library; and where it is
first seen from."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from paper_artifact.catalogue import shape_row
from paper_artifact.errors import InputError
from paper_artifact.export.models import Triangles
from paper_artifact.pages import render
from paper_artifact.scene.load import Scene

Vector = tuple[float, float, float]
DISTANCE = 2.6  # of a camera that frames everything, in bounding radii
FROM, UP = (0.78, 0.53, 0.34), (0.0, 0.0, 1.0)  # where nothing else is known: towards the camera, upwards


@dataclass(frozen=True)
class Viewpoint:
    """A camera position of the viewer, world units."""

    eye: Vector  # where the camera is
    target: Vector  # what it looks at, and what the view turns around
    up: Vector  # upwards in the picture, and the axis that the view turns about; any length


def framing(points: np.ndarray, direction: Sequence[float] = FROM, up: Sequence[float] = UP) -> Viewpoint:
    """Return the viewpoint that frames the points (n,3), world units, seen from `direction` (towards the
    camera, any length)."""
    low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0
    towards = np.asarray(direction, dtype=float)
    if tuple(direction) == FROM and up[1] == 1:
        towards = towards[[1, 2, 0]]  # from above one side, too, where y is upwards
    return Viewpoint(
        _vector(centre + DISTANCE * radius * towards / np.linalg.norm(towards)), _vector(centre), _vector(up)
    )


def up_of(file: str | None) -> Vector:
    """Return what is upwards in a mesh of that file name, or in a soup that is called after it: y for the
    formats of modelling programs (OBJ, GLB, glTF), else z; of a shape of the study what its row has. The view
    has a button for what is otherwise."""
    if row := shape_row(str(file)):
        return row.up
    return (0.0, 1.0, 0.0) if re.search(r"\.(obj|glb|gltf)(-|$)", str(file).lower()) else UP


def scene_viewpoint(scene: Scene) -> Viewpoint:
    """Return the scene's first training camera, turning around the point of its optical axis at the median
    depth of the SfM cloud, about the mean of all cameras' upward directions."""
    forward = scene.world_to_clip[:, 3, :3].astype(float)
    down = scene.world_to_clip[:, 1, :3].astype(float)
    down -= (down * forward).sum(axis=1, keepdims=True) * forward  # the principal point's share
    up = -(down / np.linalg.norm(down, axis=1, keepdims=True)).mean(axis=0)
    first = int(scene.train[0])
    eye, ahead = scene.camera_centres[first].astype(float), forward[first]
    depths = (scene.points - eye) @ ahead
    depth = float(np.median(depths[depths > 0])) if (depths > 0).any() else scene.radius
    if np.linalg.norm(up) < 1e-6 or np.linalg.norm(np.cross(up, ahead)) < 1e-6:  # no common upwards
        up = -down[first]
    return Viewpoint(_vector(eye), _vector(eye + depth * ahead), _vector(up / np.linalg.norm(up)))


def _vector(values: Sequence[float] | np.ndarray) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


MOST_TRIANGLES = 400_000  # about 25 MB of HTML


def html_page(
    parts: Mapping[str, Triangles],
    title: str,
    viewpoint: Viewpoint | None = None,
    back: tuple[str, str] | None = None,
) -> str:
    """Return a page that shows `parts` (name → triangles, world units) side by side, turning together, or one
    of them alone.

    viewpoint: where it is first seen from (default: all of it, from above one side, z upwards); back:
    address and words of a link to where the page belongs. Drag to orbit, wheel or pinch to zoom, double click
    to reset; "light" is a headlight, "colours" shows the triangles' own instead of one grey. Triangles of
    mean opacity below .5 are left out. Raises InputError for no parts, a part that is empty or not finite,
    or more triangles than a page can hold.
    """
    shown = {name: triangles.visible() for name, triangles in parts.items()}
    if not shown:
        raise InputError("a 3-D view needs at least one set of triangles")
    count = sum(len(triangles) for triangles in shown.values())
    if count > MOST_TRIANGLES:
        raise InputError(
            f"{count} triangles are too many for one page (at most {MOST_TRIANGLES}); simplify the mesh first"
        )
    points = np.concatenate([triangles.vertices.reshape(-1, 3) for triangles in shown.values()])
    if not np.isfinite(points).all():
        raise InputError(
            "the triangles hold coordinates that are not finite; the run that made them has diverged"
        )
    low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    seen = viewpoint or framing(points)
    data = {
        "centre": [float(x) for x in (low + high) / 2],
        "radius": float(np.linalg.norm(high - low) / 2) or 1.0,
        "eye": seen.eye,
        "target": seen.target,
        "up": seen.up,
        "parts": [
            {
                "name": name,
                "count": len(triangles),
                "positions": _base64(triangles.vertices.astype("<f4")),
                "colours": _base64(np.rint(triangles.colours * 255).astype(np.uint8)),
            }
            for name, triangles in shown.items()
        ],
    }
    # "<" escaped: no name can end the script element.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return render("viewer.html", title=title, back=back, data=text)


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
