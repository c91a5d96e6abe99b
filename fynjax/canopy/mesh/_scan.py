"""Plant models from scanned plants: point clouds with normals.

A scanner or a photogrammetric model gives points on surfaces, not surfaces. A point's area is that
of its surroundings: its k nearest neighbours, projected along its normal, lie in a disc, of which
it stands for the k-th part. Where points lie at random on a smooth surface, that is the surface's
area; where leaves are smaller than the disc, or closer together than the points, it is wrong, so
give the plant's areas where they are known (`organ_area`). Each point stands for one side of a
sheet: a leaf scanned from above and from below counts twice.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from fynjax._core.errors import InputError
from fynjax._core.tables import TextTable, name_and_unit, open_points, places_of
from fynjax.canopy._plant import Organ, organ_named, organ_of_name
from fynjax.canopy.mesh._bounds import check_mesh_file
from fynjax.canopy.mesh._facets import draw_groups
from fynjax.canopy.mesh._plant_mesh import MeshPlant, PlantMaterial, check_extent, mesh_plant

_LARGEST_LENGTH_MISS = 0.01
_COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
_ALIASES = {
    **{name: (name,) for name in "xyz"},
    **{f"n{name}": (f"n{name}", f"normal_{name}", f"normal{name}") for name in "xyz"},
    "organ": ("organ", "scalar_organ"),
}
"""Names of the columns in files, in lower case; CloudCompare adds "scalar_"."""


def read_scan(
    path: str | Path,
) -> tuple[
    Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3"], Int[np.ndarray, " point"] | None
]:
    """Points, normals and organs of a scanned plant.

    **Arguments:**

    - `path`: PLY with the vertex properties x, y, z, nx, ny, nz, or text (CSV, TXT, XYZ; commas,
      semicolons, tabs or blanks between) with these columns under a header, which may be a comment
      as CloudCompare writes it, or in this order without one. A column `organ` holds leaf, wood,
      flower or 0, 1, 2.

    **Returns:** points [m], normals [-], and the organ of each point, None if the file has none.

    **Raises:** `InputError` for a file without normals or that cannot be read, and with the row of
    a cell that is wrong.
    """
    file = str(path)
    is_ply = Path(path).suffix.lower() == ".ply"
    columns = _ply_columns(file) if is_ply else _text_columns(file)
    missing = [name for name in _COLUMNS if name not in columns]
    if missing:
        raise InputError(
            f"a scanned plant must have points with normals (x, y, z, nx, ny, nz), but has no "
            f"{', '.join(missing)}: compute normals where the cloud was made",
            file=file,
        )
    points = np.stack([columns[name] for name in _COLUMNS[:3]], axis=-1)
    normals = np.stack([columns[name] for name in _COLUMNS[3:]], axis=-1)
    organs = columns.get("organ")
    return points, normals, None if organs is None else organs.astype(int)


def plant_model_from_points(
    points: Float[np.ndarray, "point 3"],
    normals: Float[np.ndarray, "point 3"],
    n_elements: int | None = None,
    organ: Int[np.ndarray, " point"] | Organ | str = Organ.LEAF,
    *,
    organ_area: dict[Organ | str, float] | None = None,
    neighbours: int = 12,
    up: Literal["y", "z"] = "z",
    maximum_extent: float = 10.0,
    seed: int = 0,
) -> MeshPlant:
    """Plant model of a scanned plant.

    **Arguments:**

    - `points`: on its surfaces [m].
    - `normals`: unit normals; their sign does not matter.
    - `n_elements`: number of elements, shared among the organs by area, at least one each; None
      keeps every point.
    - `organ`: of all points, or of each (0 leaf, 1 wood, 2 flower).
    - `organ_area`: one-sided area [m2] of organs where it is known; the others get the area that
      follows from the spacing of their points (see this module).
    - `neighbours`: number of neighbours that a point's surroundings are taken from, at least 4.
    - `up`, `maximum_extent`: as in `plant_model_from_mesh`.
    - `seed`: fixes which points are drawn.

    **Returns:** a `MeshPlant`. Not differentiable.

    **Raises:** `InputError` for normals that are zero or not of unit length, points that are not
    finite, too few, flat or in other units, organs or areas out of range, and an organ whose
    points have no area.
    """
    points, normals = np.asarray(points, float), np.asarray(normals, float)
    if points.ndim != 2 or points.shape[1] != 3 or normals.shape != points.shape:
        raise InputError(
            "`points` and `normals` must both be [point, 3], but are "
            f"{points.shape} and {normals.shape}"
        )
    if neighbours < 4 or len(points) <= neighbours:
        raise InputError(
            f"a scanned plant must have more points than `neighbours`, at least 4, but has "
            f"{len(points)} and {neighbours}"
        )
    if up not in ("y", "z"):
        raise InputError(f"`up` must be 'y' or 'z', but is {up!r}")
    if up == "y":
        points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=-1)
        normals = np.stack([normals[:, 0], -normals[:, 2], normals[:, 1]], axis=-1)
    box = check_extent(points, maximum_extent, None, "a scanned plant")
    _check_normals(normals)
    of_point = _organs(organ, len(points))

    area = _areas(points, normals, of_point, organ_area or {}, neighbours)
    chosen, portion = np.arange(len(points)), area
    if n_elements is not None and n_elements < len(points):
        drawn = draw_groups(of_point, area, normals, points, n_elements, seed)
        chosen = np.concatenate(drawn)
        total = np.bincount(of_point, weights=area)
        portion = np.repeat([total[of_point[p[0]]] / len(p) for p in drawn], list(map(len, drawn)))
    present = [kind for kind in Organ if (of_point == kind).any()]
    index = np.array([present.index(kind) if kind in present else -1 for kind in Organ])
    return mesh_plant(
        points[chosen],
        normals[chosen],
        portion,
        index[of_point[chosen]],
        {kind.name.lower(): PlantMaterial(kind) for kind in present},
        box,
        (0.0,) * len(present),
    )


def _areas(
    points: np.ndarray,
    normals: np.ndarray,
    organ: np.ndarray,
    organ_area: dict[Organ | str, float],
    neighbours: int,
) -> np.ndarray:
    """Area of each point [m2]: from the spacing of its organ's points, scaled where that of the
    organ is known."""
    area = np.zeros(len(points))
    known = {organ_named(key): float(value) for key, value in organ_area.items()}
    for kind in Organ:
        members = organ == kind
        if kind in known and not (np.isfinite(known[kind]) and known[kind] > 0.0 and members.any()):
            raise InputError(
                f"`organ_area` of {kind.name.lower()} must be positive [m2] and the organ have "
                f"points, but is {known[kind]:g} with {members.sum()} points"
            )
        if members.any():
            area[members] = _point_areas(points[members], normals[members], neighbours)
            if not area[members].sum() > 0.0:
                raise InputError(
                    f"the points of the {kind.name.lower()} must spread over an area, but all "
                    f"{members.sum()} lie at one place: duplicate points?"
                )
        if kind in known:
            area[members] *= known[kind] / area[members].sum()
    return area


def _point_areas(points: np.ndarray, normals: np.ndarray, neighbours: int) -> np.ndarray:
    """Area of the surface that each point stands for [m2]."""
    from scipy.spatial import cKDTree  # late: the parametric forms do without

    count = min(neighbours, len(points) - 1)
    if count < 1:
        raise InputError("an organ of a scanned plant must have at least two points, but has one")
    _, near = cKDTree(points).query(points, k=count + 1)
    reach = points[near[:, -1]] - points
    # Squared distance to the farthest of them across the normal; at an edge, where it lies along
    # the normal, a quarter of the whole counts at least.
    along = np.einsum("ni,ni->n", reach, normals)
    level = np.maximum((reach**2).sum(axis=1) - along**2, 0.25 * (reach**2).sum(axis=1))
    # The mean of pi r^2 / k is the area per point where points lie at random.
    return np.pi * level / count


def _check_normals(normals: np.ndarray) -> None:
    if not np.isfinite(normals).all():
        raise InputError("`normals` must be finite, but some are not")
    length = np.linalg.norm(normals, axis=1)
    zero = int((length < 1e-6).sum())
    if zero:
        raise InputError(
            f"`normals` must be unit vectors, but {zero} of {len(normals)} are zero: compute them "
            "anew, or drop these points"
        )
    if np.abs(length - 1.0).max() > _LARGEST_LENGTH_MISS:
        raise InputError(
            "`normals` must be unit vectors, but their lengths range from "
            f"{length.min():.3g} to {length.max():.3g}"
        )


def _organs(organ: Any, count: int) -> np.ndarray:
    if isinstance(organ, str | Organ):
        return np.full(count, int(organ_named(organ)))
    organ = np.asarray(organ)
    if organ.shape != (count,) or not np.isin(organ, [int(kind) for kind in Organ]).all():
        raise InputError(
            f"`organ` must be 0 (leaf), 1 (wood) or 2 (flower) for each of {count} points, but has "
            f"the shape {organ.shape} and values {np.unique(organ)[:5].tolist()}"
        )
    return organ.astype(int)


def _ply_columns(file: str) -> dict[str, np.ndarray]:
    import trimesh

    check_mesh_file(file, "a scan with normals")
    try:
        with np.errstate(all="ignore"):  # of numbers that are checked below
            cloud = trimesh.load(file, process=False)
        data = cloud.metadata["_ply_raw"]["vertex"]["data"]
        names = data.dtype.names if hasattr(data, "dtype") else list(data)
        return {
            wanted: np.asarray(data[names[place]], float).reshape(-1)
            for wanted, place in places_of(map(str, names), _ALIASES).items()
        }
    except Exception as error:  # trimesh's readers raise whatever they stumble over
        raise InputError(f"the scan cannot be read: {error}", file=file) from error


def _text_columns(file: str) -> dict[str, np.ndarray]:
    table = open_points(file, "a scanned plant", _COLUMNS[:3])
    if not table.headed:
        if table.width > len(_COLUMNS) + 1:
            raise InputError(
                f"a scanned plant of {table.width} columns must name them in a header (x, y, z, "
                "nx, ny, nz and, if wanted, organ), but has none",
                file=file,
            )
        table.names = (*_COLUMNS, "organ")[: table.width]
    places = places_of(table.names, _ALIASES, file=file, row=table.row)
    for axis in set(_COLUMNS[:3]) & set(places):
        name = table.names[places[axis]]
        unit = name_and_unit(name)[1]
        if unit not in ("", "m", "metre", "metres", "meter", "meters"):
            raise InputError(
                f"expected metres, but the header says {unit!r}. Convert the coordinates.",
                file=file,
                row=table.row,
                column=name,
            )
    organ = places.pop("organ", None)
    frame = table.columns(list(places.values()), () if organ is None else (organ,))
    columns = {name: frame[place].to_numpy() for name, place in places.items()}
    if organ is not None:
        columns["organ"] = _organ_column(table, frame[organ].to_numpy(str))
    return columns


def _organ_column(table: TextTable, cells: np.ndarray) -> np.ndarray:
    """Organs written as numbers or as words."""
    values, index = np.unique(cells, return_inverse=True)
    organs = np.empty(len(values))
    for k, value in enumerate(map(str, values)):
        try:
            organ: float | None = float(value)
        except ValueError:
            organ = organ_of_name(value)
        if organ is None or organ not in list(Organ):
            raise InputError(
                f"expected 0 or leaf, 1 or wood, 2 or flower, but found {value!r}",
                file=table.path,
                row=[*table.rows()][int(np.argmax(index == k))][0],
                column="organ",
            )
        organs[k] = organ
    return organs[index]
