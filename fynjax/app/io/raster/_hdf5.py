"""Whether a NetCDF file keeps its values itself, asked of the HDF5 library that netCDF4 brings."""

import ctypes
import os
from pathlib import Path

_HARD, _SOFT = 0, 1
"""Links that stay within a file; all others lead out of it."""
_DATASET = 5
_VIRTUAL = 3
"""Layout of a dataset that is put together from those of other files."""


def names_others(path: Path) -> bool:
    """Whether an HDF5 file has links to other files, or datasets whose values are in others.

    netCDF4 follows all of these and shows none. Nothing is read here but the file's own tables.

    **Arguments:** `path`, a file of any format.

    **Returns:** false also for what is no HDF5 file, and where netCDF4's library does not offer its
    functions to others, as on Windows.
    """
    from netCDF4 import _netCDF4

    try:
        hdf5 = ctypes.CDLL(_netCDF4.__file__)
        hdf5.H5open()
        visit = getattr(hdf5, "H5Lvisit1", None) or hdf5.H5Lvisit
        for name in ("H5Fopen", "H5Oopen", "H5Dget_create_plist"):
            getattr(hdf5, name).restype = ctypes.c_int64
    except (AttributeError, OSError):
        return False
    same = ctypes.c_int64(0)  # default properties
    found: list[bytes] = []

    def look(group: int, name: bytes, link: ctypes._Pointer, _: None) -> int:
        if link[0] == _HARD:
            one = ctypes.c_int64(hdf5.H5Oopen(ctypes.c_int64(group), name, same))
            if hdf5.H5Iget_type(one) == _DATASET:
                made = ctypes.c_int64(hdf5.H5Dget_create_plist(one))
                outside = hdf5.H5Pget_external_count(made) > 0
                if outside or hdf5.H5Pget_layout(made) == _VIRTUAL:
                    found.append(name)
                hdf5.H5Pclose(made)
            hdf5.H5Oclose(one)
        elif link[0] != _SOFT:
            found.append(name)
        return len(found)  # more than nothing ends the visit

    # The type of a link is the first of its facts in every version.
    facts = ctypes.POINTER(ctypes.c_int)
    kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int64, ctypes.c_char_p, facts, ctypes.c_void_p)
    hdf5.H5Eset_auto2(same, None, None)  # it prints otherwise
    file = ctypes.c_int64(hdf5.H5Fopen(os.fsencode(path), 0, same))
    if file.value < 0:
        return False
    visit(file, 0, 0, kind(look), None)
    hdf5.H5Fclose(file)
    return bool(found)
