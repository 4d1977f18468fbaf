"""H as a labelled array of xarray, which reads it lazily."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import AXES, InputError

if TYPE_CHECKING:
    import xarray

    from lfcal.psf.matrix import PSFMatrix


def data_array(H: PSFMatrix) -> xarray.DataArray:
    """Return ``H`` as an array with named axes and coordinates; see `PSFMatrix.to_xarray`."""
    try:
        import xarray
        from xarray.backends import BackendArray
        from xarray.core import indexing
    except ImportError:
        raise InputError("xarray is not installed; run: pip install xarray") from None

    class Lazy(BackendArray):
        """The values of H, by integers and slices."""

        shape, dtype = H.shape, H.dtype

        def __getitem__(self, key: Any) -> Any:
            """Return the selected values in memory."""
            support = indexing.IndexingSupport.BASIC
            return indexing.explicit_indexing_adapter(key, self.shape, support, H.__getitem__)

    z_units = {"units": "um"} if H.knows_depths else {}
    coordinates = {
        "z": ("z", H.depths, {"long_name": "depth" if H.knows_depths else "plane", **z_units}),
        **{
            axis: (axis, np.arange(n), {"long_name": "source position"}) for axis, n in zip("yx", H.period, strict=True)
        },
        **{
            axis: (axis, np.arange(n) - (n - 1) // 2, {"units": "px", "long_name": "pixel of the cutout"})
            for axis, n in zip("ts", H.cutout, strict=True)
        },
    }
    facts = {"anchor": H.anchor, "region": H.region} | ({"camera": H.camera.name} if H.camera is not None else {})
    name = "HT" if H.is_transposed else "H"
    return xarray.DataArray(
        xarray.Variable(AXES, indexing.LazilyIndexedArray(Lazy())), coords=coordinates, name=name, attrs=facts
    )
