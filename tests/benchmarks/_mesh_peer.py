"""Leaf discs as a mesh, rendered by Mitsuba 3: run by an interpreter that has it.

`python _mesh_peer.py SCENE.npz IMAGES.npz [--samples N]`; a file of its own, without fynjax.
Leaves reflect and transmit by Lambert's law, which no material of Mitsuba does, so one is made.
The scene has `centre` and `normal` [disc, 3], `diameter` [disc] or one, `rho` and `tau` [band] or
[disc, band], `ground` [band], `side` [m], `copies` of it on each side (0 stands alone), `pixels`
along a side, `sun` and `views` as unit vectors, `direct` and `sky` irradiance [band].
"""

import argparse
import itertools
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")


class Leaf(mi.BSDF):
    """Thin surface that reflects `rho` and transmits `tau`, alike from both sides."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [
            mi.BSDFFlags.DiffuseReflection | sides,
            mi.BSDFFlags.DiffuseTransmission | sides,
        ]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def optics(self, si: Any, active: Any) -> tuple[Any, Any, Any]:
        """Reflectance, transmittance, and the share of light that is sent back."""
        rho = si.shape.eval_attribute_3("face_rho", si, active)
        tau = si.shape.eval_attribute_3("face_tau", si, active)
        rho, tau = mi.Color3f(rho), mi.Color3f(tau)
        return rho, tau, dr.sum(rho) / dr.maximum(dr.sum(rho) + dr.sum(tau), 1e-6)

    def value(self, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        """Value times cosine, and density."""
        rho, tau, back = self.optics(si, active)
        cos_in, cos_out = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        same = cos_in * cos_out > 0
        flux = dr.abs(cos_out) * dr.inv_pi
        value = dr.select(same, rho, tau) * flux
        density = dr.select(same, back, 1.0 - back) * flux
        hit = active & (cos_in != 0)
        return dr.select(hit, value, 0.0), dr.select(hit, density, 0.0)

    def sample(self, ctx: Any, si: Any, choice: Any, point: Any, active: Any = True) -> Any:
        wo = mi.warp.square_to_cosine_hemisphere(point)
        side = dr.select(mi.Frame3f.cos_theta(si.wi) > 0, 1.0, -1.0)
        reflected = choice < self.optics(si, active)[2]
        wo.z *= dr.select(reflected, side, -side)
        value, density = self.value(si, wo, active)
        sampled = mi.BSDFSample3f()
        sampled.wo = wo
        sampled.pdf = density
        sampled.eta = 1.0
        sampled.sampled_type = dr.select(
            reflected,
            mi.UInt32(+mi.BSDFFlags.DiffuseReflection),
            mi.UInt32(+mi.BSDFFlags.DiffuseTransmission),
        )
        sampled.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(1))
        return sampled, dr.select(density > 0, value / dr.maximum(density, 1e-12), 0.0)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.value(si, wo, active)[0]

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.value(si, wo, active)[1]

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.value(si, wo, active)

    def to_string(self) -> str:
        return "Leaf[]"


mi.register_bsdf("leaf", Leaf)


def discs(
    centre: np.ndarray,
    normal: np.ndarray,
    diameter: np.ndarray,
    rho: np.ndarray,
    tau: np.ndarray,
    sides: int,
) -> Any:
    """One mesh of regular polygons of the discs' area, each a fan of triangles."""
    count = len(centre)
    turn = np.arange(sides) * 2 * np.pi / sides
    wider = np.sqrt(2 * np.pi / (sides * np.sin(2 * np.pi / sides)))
    radius = 0.5 * wider * np.broadcast_to(diameter, count)[:, None, None]
    other = np.where(np.abs(normal[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    one = np.cross(normal, other)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(normal, one)
    ring = one[:, None] * np.cos(turn)[:, None] + two[:, None] * np.sin(turn)[:, None]
    vertices = centre[:, None] + radius * ring
    fan = np.stack(
        [np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], axis=-1
    )
    faces = fan[None] + sides * np.arange(count)[:, None, None]
    mesh = mi.Mesh("leaves", count * sides, faces.size // 3, has_vertex_normals=False)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    for name, values in (("face_rho", rho), ("face_tau", tau)):
        each = np.broadcast_to(values, (count, 3)).astype(np.float32)
        mesh.add_attribute(name, 3, np.repeat(each, sides - 2, axis=0).ravel())
    return mesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene")
    parser.add_argument("images")
    parser.add_argument("--samples", type=int, default=256)
    arguments = parser.parse_args()
    s = dict(np.load(arguments.scene))
    side, pixels, copies = float(s["side"]), int(s["pixels"]), int(s["copies"])
    place = mi.ScalarTransform4f

    def colour(values: np.ndarray) -> dict:
        return {"type": "rgb", "value": [float(v) for v in values]}

    # A mesh keeps the material it is made with: it goes through a file.
    sides = 12 if len(s["centre"]) < 10_000 else 6  # memory
    mesh = discs(s["centre"], s["normal"], s["diameter"], s["rho"], s["tau"], sides)
    file = arguments.images + ".ply"
    mesh.write_ply(file)

    def plate(half: float, height: float, reflectance: np.ndarray) -> dict:
        return {
            "type": "rectangle",
            "to_world": place().translate([side / 2, side / 2, height]).scale([half, half, 1]),
            "bsdf": {"type": "diffuse", "reflectance": colour(reflectance)},
        }

    sun = s["sun"]  # unit vector towards it
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 64, "rr_depth": 16},
        "sun": {
            "type": "directional",
            "direction": [float(-v) for v in sun],
            "irradiance": colour(s["direct"] / sun[2]),
            "sampling_weight": 0.9,
        },
        "sky": {"type": "constant", "radiance": colour(s["sky"] / np.pi), "sampling_weight": 0.1},
        "ground": plate((copies + 0.5) * side, 0.0, s["ground"]),
        # The constant emitter also shines from below the horizon: it is kept out.
        "under": plate(5e3, -1e-3, np.zeros(3)),
    }
    leaves = {"type": "ply", "filename": file, "face_normals": True, "bsdf": {"type": "leaf"}}
    if copies == 0:
        scene["leaves"] = leaves
    else:
        scene["group"] = {"type": "shapegroup", "leaves": leaves}
        for i, j in itertools.product(range(-copies, copies + 1), repeat=2):
            scene[f"tile_{i + copies}_{j + copies}"] = {
                "type": "instance",
                "group": {"type": "ref", "id": "group"},
                "to_world": place().translate([i * side, j * side, 0.0]),
            }
    loaded = mi.load_dict(scene)
    result: dict[str, Any] = {}
    middle = np.array([side / 2, side / 2, 0.0])
    for index, view in enumerate(s["views"]):
        # A wide square across the view holds all of the ground and the crown.
        half = side / 2 if view[2] > 0.9999 else 0.75 * side
        count = pixels if view[2] > 0.9999 else 4 * pixels
        up = [0.0, 1.0, 0.0] if view[2] > 0.9999 else [0.0, 0.0, 1.0]
        sensor = mi.load_dict({
            "type": "orthographic",
            "to_world": place().look_at(
                origin=[float(v) for v in middle + 20 * view],
                target=[float(v) for v in middle],
                up=up,
            ).scale([half, half, 1]),
            "near_clip": 0.1,
            "far_clip": 100.0,
            "film": {
                "type": "hdrfilm", "width": count, "height": count, "rfilter": {"type": "box"},
                "pixel_format": "rgb", "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        })  # fmt: skip
        halves, began = [], time.process_time()
        samples = arguments.samples if count == pixels else max(1, arguments.samples // 16)
        for seed in (1, 2):
            image = mi.render(
                loaded, sensor=sensor, spp=max(1, samples // 2), seed=10 * index + seed
            )
            halves.append(np.pi * np.flipud(np.array(image)[..., :3]))
        if count == pixels:
            result["nadir"] = np.stack(halves)
            result["cpu_s"] = np.array(time.process_time() - began)
        # What leaves the scene towards the view, over the ground's area seen under that angle.
        flux = np.stack([h.sum(axis=(0, 1)) for h in halves]) * (2 * half / count) ** 2
        result[f"brf_{index}"] = flux / (side**2 * view[2])
    np.savez_compressed(arguments.images, **result)


if __name__ == "__main__":
    main()
