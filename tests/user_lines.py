"""Lines as a user writes them, for the check of types: mypy has no error in them."""

import jax
import numpy as np
import pandas as pd

import fynjax as fx
from fynjax.scene import PlotParameters


def forward(table: str) -> fx.Scene:
    """A scene, an image and a gradient."""
    scene = fx.read_scene(table, size=2.0, seed=1)
    image = fx.observe(scene, "mavic_3m", pixel=0.1)
    print(scene, image["nir"], image.index("NDVI"), image.to_xarray(), image.to_dataframe())
    camera = fx.sensor("mavic_3m")

    def ndvi(p: PlotParameters) -> jax.Array:
        seen = fx.observe(scene, camera, pixel=0.1, parameters=p)
        mean: jax.Array = seen.index("NDVI").mean()
        return mean

    print(fx.observe(scene, "flash_lidar_paper").metric("height_p95"), scene.parameters)
    print(jax.grad(ndvi)(scene.parameters).species.cover)
    return scene.with_values({"species.*.cover": 0.1})


def backward(scene: fx.Scene) -> None:
    """Data, a fit and draws."""
    free = fx.free(scene, "species.*.cover", prior=fx.prior("fynbos_2023"))
    data = fx.Data.from_image("drone.tif", fx.sensor("mavic_3m"))
    data = data + fx.Data.from_spectrum("spectrum.csv") + fx.Data.from_cloud("cloud.laz", scene)
    found = fx.fit(scene, data, free, solver=fx.BroydenLM())
    print(found, found.stand(), fx.sample(found, "emcee").inference_data())


def leaves() -> None:
    """Leaf optics."""
    leaf = fx.Leaf(chlorophyll=40.0)
    r, t = fx.prospect(chlorophyll=40.0)
    print(fx.prospect(leaf).reflectance, r + t, fx.prospect(chlorophyll=[20.0, 40.0]))


def spectra(r: np.ndarray, table: pd.DataFrame) -> pd.DataFrame:
    """Leaf spectra from files, arrays and tables, fitted."""
    measured = fx.read_spectra("leaves")
    fit = fx.fit_leaf(measured)
    print(fit, fit.labels, fit.plot("protea"), fit.to_xarray()["water"].sel(leaf="protea"))
    fx.fit_leaf(range(400, 2501), r, leaf_shape="needle")
    fx.fit_leaf(measured["reflectance"], transmittance=measured["transmittance"])
    fx.fit_leaf(table, transmittance=table, measurement=fx.leaf.LeafClip())
    return fit.table(area="half_total")
