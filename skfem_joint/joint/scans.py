"""Measured topography of faces: values at places, in the coordinates of the scan.

A scan of *gaps* says how far two faces are apart. One of *heights* says how far a face stands out
of its nominal plane, towards the other face: the gap is smaller by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.spatial import ConvexHull, QhullError, cKDTree

from skfem_joint.ground.arrays import FloatArray, as_real
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.text_tables import LENGTHS, Mistakes, column_units, read_columns
from skfem_joint.ground.values import FINITE, NOT_NEGATIVE, POSITIVE, check, check_each
from skfem_joint.mesh.cells import nearest_places, spot
from skfem_joint.mesh.node_fields import node_field

#: What a surface says, by the name of its column.
KINDS = ("gap", "height")
#: Columns of places of a scan.
_PLACES = ("x", "y")
_EXAMPLE = "'x (mm), y (mm), height (um)'"
#: Share of the extent of a scan by which places may lie outside by round-off.
_ROUND_OFF = 1e-9
#: Least cosine of the angle between a face and the plane of its scan.
_ALONG = 0.5


@dataclass(frozen=True, eq=False)
class Scan:
    """Measured topography of a face, or of the gap between two, linear between its places.

    Attributes
    ----------
    places : array_like, shape (k,), (k, 1) or (k, 2)
        Where it was measured, in the coordinates of the scan, m: along a line for joints of plates
        from the side, in a plane for those of solids.
    values : array_like, shape (k,)
        m; nan where nothing was measured.
    kind : {"gap", "height"}
        Distance of the faces, or how far this face stands out towards the other one.
    origin : tuple of float, optional
        Where the scan's origin lies on the mesh, m; at its origin if not given.
    axes : tuple of tuple of float, optional
        Directions of the scan's axes on the mesh, of any length; x, and y, if not given.
    margin : float
        Distance beyond the outermost places, m, up to which the values at the edge go on.
    name : str
        What messages call it: its file.
    """

    places: Any
    values: Any
    kind: str = "gap"
    origin: Sequence[float] | None = None
    axes: Sequence[Sequence[float]] | None = None
    margin: float = 0.0
    name: str = "scan"

    def __post_init__(self) -> None:
        places = np.asarray(as_real(self.places, f"{self.name}: places"))
        places = places[:, np.newaxis] if places.ndim == 1 else places
        values = np.asarray(as_real(self.values, f"{self.name}: values"))
        if places.ndim != 2 or places.shape[1] not in (1, 2) or values.shape != places.shape[:1]:
            raise InputError(
                f"{self.name}: found places of shape {places.shape} and values of shape "
                f"{values.shape}, must be (k, 1) or (k, 2), and (k,)"
            )
        if self.kind not in KINDS:
            raise InputError(f"{self.name}: found kind {self.kind!r}, must be 'gap' or 'height'")
        check(f"{self.name}: margin", self.margin, NOT_NEGATIVE)
        measured = ~np.isnan(values)
        if not (np.isfinite(places).all() and np.isfinite(values[measured]).all()):
            raise InputError(
                f"{self.name}: found a place or value that is not finite; leave it out, or have "
                "nan as the value where nothing was measured"
            )
        object.__setattr__(self, "places", places[measured])
        object.__setattr__(self, "values", values[measured])
        self._check_places()
        self._check_axes()

    def _check_places(self) -> None:
        """Refuse too few places, those in one line, and two values at one place."""
        count, dim = self.places.shape
        if count < dim + 1:
            raise InputError(f"{self.name}: found {count} measured places, must be >= {dim + 1}")
        _, first, times = np.unique(self.places, axis=0, return_index=True, return_counts=True)
        if np.any(times > 1):
            twice = self.places[first[np.argmax(times)]]
            raise InputError(
                f"{self.name}: found {times.max()} values at one place, {spot(twice)}, must be one"
            )
        if dim == 2:
            try:
                _ = self._hull
            except QhullError:
                raise InputError(
                    f"{self.name}: its places lie in one line, must lie in a plane; leave out a "
                    "coordinate for a joint of a plate from the side"
                ) from None

    def _check_axes(self) -> None:
        """Refuse axes that are not as many as the scan has, or not across each other."""
        dim = self.places.shape[1]
        if self.origin is not None:
            check_each(f"{self.name}: origin", self.origin, FINITE)
        if self.axes is None:
            return
        for number, axis in enumerate(self.axes):
            check_each(f"{self.name}: axes[{number}]", axis, FINITE)
        lengths = {len(axis) for axis in self.axes}
        units = np.zeros((0, 0))
        if len(self.axes) == dim and lengths <= {dim + 1}:
            units = np.array([np.asarray(a, float) / (np.linalg.norm(a) or 1.0) for a in self.axes])
        if not units.size or np.abs(units @ units.T - np.eye(dim)).max() > 1e-6:
            what = (
                "a direction [x, y]" if dim == 1 else "two directions [x, y, z] across each other"
            )
            raise InputError(
                f"{self.name}: axes: found {[list(axis) for axis in self.axes]}, must be {what}, "
                f"since it has {dim} coordinate{'s' if dim > 1 else ''}"
            )

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(self.places)

    @cached_property
    def extent(self) -> float:
        """Largest extent of the places, m."""
        return float(np.ptp(self.places, axis=0).max())

    def at(self, x: FloatArray, normal: FloatArray) -> FloatArray:
        """Gap at points, (k,), m, but for a constant if it has heights.

        Parameters
        ----------
        x, normal : ndarray, shape (k, dim)
            Points of the face, m, and its normals there.

        Raises
        ------
        InputError
            If the joint is of another dimension, if the face does not lie along the scan's axes,
            or if points lie outside of the scan.
        """
        dim = self.places.shape[1]
        if x.shape[1] != dim + 1:
            what = ("a line, x", "a plane, x and y")[x.shape[1] - 2]
            raise InputError(
                f"{self.name}: found {dim} coordinate{'s' if dim > 1 else ''} of places, must be "
                f"those of {what}, for a joint of a mesh of {x.shape[1]} dimensions"
            )
        axes = np.eye(dim, dim + 1) if self.axes is None else np.asarray(self.axes, dtype=float)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        origin = np.zeros(dim + 1) if self.origin is None else np.asarray(self.origin, dtype=float)
        if origin.shape != (dim + 1,):
            raise InputError(f"{self.name}: origin: found {origin.size} numbers, must be {dim + 1}")
        across = np.linalg.norm(normal @ axes.T, axis=1)
        if np.any(across > np.sqrt(1.0 - _ALONG**2)):
            worst = int(across.argmax())
            raise InputError(
                f"{self.name}: the face at {spot(x[worst])} lies across the scan's axes "
                f"{axes.tolist()}; give the directions of its axes along the face (axes)"
            )
        values = self._interpolated(np.asarray((x - origin) @ axes.T))
        return values if self.kind == "gap" else -values

    def _interpolated(self, places: FloatArray) -> FloatArray:
        """Values at places in the scan's own coordinates, (k,)."""
        if self.places.shape[1] == 1:
            order = np.argsort(self.places[:, 0])
            known, s = self.places[order, 0], places[:, 0]
            self._refuse_outside(np.maximum(known[0] - s, s - known[-1]), places)
            return np.asarray(np.interp(s, known, self.values[order]))
        values = np.asarray(self._linear(places))
        outside = np.flatnonzero(np.isnan(values))
        if outside.size:
            nearest, distance = self._on_edge(places[outside]), np.zeros(len(places))
            distance[outside] = np.linalg.norm(nearest - places[outside], axis=1)
            self._refuse_outside(distance, places)
            known = np.asarray(self._linear(nearest))
            # The edge itself may count as outside by round-off.
            at = cKDTree(self.places).query(nearest)[1]
            values[outside] = np.where(np.isnan(known), self.values[at], known)
        return values

    @cached_property
    def _linear(self) -> Callable[[FloatArray], FloatArray]:
        from scipy.interpolate import LinearNDInterpolator

        interpolator: Callable[[FloatArray], FloatArray] = LinearNDInterpolator(
            self.places, self.values
        )
        return interpolator

    def _on_edge(self, places: FloatArray) -> FloatArray:
        """Nearest place just inside the edge of the scan to each place outside, (k, 2)."""
        edges = self.places[self._hull.simplices]
        best, least = places.copy(), np.full(len(places), np.inf)
        for edge in edges:
            foot = nearest_places(np.broadcast_to(edge, (len(places), 2, 2)), places)
            distance = np.linalg.norm(foot - places, axis=1)
            best[distance < least] = foot[distance < least]
            least = np.minimum(least, distance)
        centre = self.places[self._hull.vertices].mean(axis=0)
        return np.asarray(best + _ROUND_OFF * (centre - best))

    def _refuse_outside(self, distance: FloatArray, places: FloatArray) -> None:
        """Refuse places that lie farther outside of the scan than its margin, (k,), m."""
        outside = distance > self.margin + 10.0 * _ROUND_OFF * self.extent
        if np.any(outside):
            worst = places[int(distance.argmax())]
            raise InputError(
                f"{self.name}: {np.count_nonzero(outside)} of {distance.size} points of the joint "
                f"lie outside of it, by up to {distance.max():.3g} m, at {spot(worst)} of its "
                "coordinates; measure farther, give origin and axes of the scan, or a margin (m) "
                "up to which the values at its edge go on"
            )


def read_scan(path: str | Path, **placed: Any) -> Scan:
    """Scan from a text file with named columns (UTF-8).

    The first line names the columns: ``x`` and ``y``, or ``x`` alone for a joint of a plate from
    the side, and ``height`` or ``gap``; in metres, or with a unit in brackets, as ``height (um)``.
    A comma, a semicolon or a tab separates them. Where nothing was measured the last one is empty
    or nan. Comments after ``#`` are left out.

    Parameters
    ----------
    path : str or Path
    **placed
        ``origin``, ``axes`` and ``margin`` of `Scan`.

    Returns
    -------
    Scan

    Raises
    ------
    InputError
        If the file cannot be read, has other columns, or cells are no numbers; the message names
        the file and the lines. What `Scan` refuses.
    """
    path = Path(path)
    columns, units, lines, _ = read_columns(path, _units_of, KINDS, _EXAMPLE)
    mistakes = Mistakes(path)
    for name, column in columns.items():
        for k in np.flatnonzero(np.isinf(column) | (np.isnan(column) & (name in _PLACES))):
            found = f"{path}: line {lines[k]}: {name}: found {column[k]:g}"
            mistakes.append(f"{found}, must be finite")
        columns[name] = column * LENGTHS[units[name] or "m"]
    mistakes.refuse()
    places = np.column_stack([columns[name] for name in _PLACES if name in columns])
    _, first, back = np.unique(places, axis=0, return_index=True, return_inverse=True)
    earlier = first[back.ravel()]
    for k in np.flatnonzero(earlier != np.arange(len(places))):
        place = f"{path}: line {lines[k]}"
        mistakes.append(f"{place}: has the place of line {lines[earlier[k]]}, must be once")
    mistakes.refuse()
    (kind,) = (name for name in KINDS if name in columns)
    return Scan(places, columns[kind], kind, name=str(path), **placed)


def _units_of(texts: Sequence[str], where: str) -> dict[str, str | None]:
    """Units of the columns of a scan by their names; InputError for others."""
    units = column_units(texts, dict.fromkeys((*_PLACES, *KINDS), LENGTHS), where)
    if "x" not in units or len([name for name in units if name in KINDS]) != 1:
        raise InputError(
            f"{where}: found columns {', '.join(units)}, must be x, y and height or gap (x alone "
            f"for plates from the side), as in {_EXAMPLE}"
        )
    return units


@dataclass(frozen=True, eq=False)
class NodeField:
    """Gap, or height of a face, at nodes of a face; linear between them.

    Attributes
    ----------
    places : array_like, shape (k, 2) or (k, 3)
        Nodes of the face, on the mesh, m; a third coordinate beyond the mesh's does not count.
    values : array_like, shape (k,)
        m.
    kind : {"gap", "height"}
        Distance of the faces, or how far this face stands out towards the other one.
    name : str
        What messages call it.
    """

    places: Any
    values: Any
    kind: str = "gap"
    name: str = "field of nodes"

    def at(self, x: FloatArray, normal: FloatArray) -> FloatArray:
        """Gap at points of the face, as for `Scan`; places are those along its mean normal."""
        dim = x.shape[1]
        places = np.asarray(as_real(self.places, f"{self.name}: places"))
        if places.ndim != 2 or places.shape[1] < dim:
            raise InputError(
                f"{self.name}: found places of shape {places.shape}, must be (k, {dim})"
            )
        along = null_space(normal.mean(axis=0)[np.newaxis]).T
        origin = tuple(x.mean(axis=0))
        flat = (places[:, :dim] - origin) @ along.T
        scan = Scan(flat, self.values, self.kind, origin, along, name=self.name)
        return scan.at(x, normal)


def read_node_field(
    path: str | Path, field: str, on: str, kind: str = "gap", scale: float = 1.0
) -> NodeField:
    """Field of nodes from a mesh file of Gmsh, with values in m.

    Parameters
    ----------
    path : str or Path
        Gmsh file with a section $NodeData.
    field : str
        Its name.
    on : str
        Physical group of the face whose nodes count.
    kind : {"gap", "height"}
        Distance of the faces, or how far this face stands out towards the other one.
    scale : float
        Metres per unit of length of the file's nodes, as that of its mesh.

    Returns
    -------
    NodeField

    Raises
    ------
    InputError
        If the file cannot be read or has no such group or field.
    """
    check(f"{path}: scale", scale, POSITIVE)
    places, values = node_field(Path(path), field, on)
    return NodeField(scale * places, values, kind, f"{path}, {field}")
