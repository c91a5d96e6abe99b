"""Programs of images that are compiled before they are asked for, and kept as bytes."""

import hashlib
import json
import struct
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax import export
from jaxtyping import Array, Float

from fynjax._core.errors import InputError
from fynjax._core.extras import require
from fynjax._core.programs import check_known
from fynjax.radiation import Accuracy
from fynjax.scene._observe import _checked, _observe_with, aimed_at, lowest_sun
from fynjax.scene._parameters import PlotParameters
from fynjax.scene._scene import Scene
from fynjax.sensors import Sensor

_MAGIC = b"fynjax program\n"
_LONGEST = 1 << 20
"""Bytes of a header, at most."""
_ANEW = "Compile it anew with fx.compile"


class Program:
    """The image of one sensor over plots of one shape, as a program: from `fx.compile`, or from
    bytes that another process made (`Program.from_bytes`).

    A call traces nothing of fynjax. `to_bytes` makes of it what `pathlib.Path.write_bytes` keeps.
    """

    def __init__(
        self, exported: export.Exported, bands: tuple[str, ...], known: str, lowest: float
    ) -> None:
        self.bands = bands
        """Names of the bands of the image."""
        self.lowest = lowest
        """Largest zenith angle of the sun that is taken, 90 over a plot that repeats itself and
        where the stated `accuracy` has a margin, which is not checked [degrees]."""
        self._exported, self._known = exported, known
        self._call = jax.jit(exported.call)

    def __call__(
        self, scene: Scene, parameters: PlotParameters | None = None
    ) -> Float[Array, "band y x"]:
        """Reflectance factor of a scene at `parameters`, or at its own [-].

        Differentiable once, in reverse mode (`jax.grad`, `jax.vjp`), in parameters and in the
        scene's own arrays. Any derivative is that of the stand in expectation, and so is the value
        that comes with it (`Scene.expected`); of `fx.observe` only those are that move the number
        of plants. In forward mode, and of `jax.vmap` and `jax.jacrev`, take `fx.observe`.

        **Raises:** `InputError` for a scene of other shapes, growth forms, terrain or settings than
        the one that the program was compiled with, for a sun below `lowest` outside `jit`, for a
        traced terrain, and for parameters as of `fx.observe`.
        """
        leaves, known, sun, part = _given(scene, parameters)
        self._check_sun(leaves[sun])
        shapes = [(*np.shape(leaf),) for leaf in leaves]
        asked = [own.shape for own in self._exported.in_avals]
        if known != self._known or shapes != asked:
            same = known == self._known
            what = "numbers of plants" if same else "growth forms, sides, terrain or settings"
            raise InputError(
                f"expected a scene with the shapes that the program was compiled with, but {what} "
                "of this one are others; another seed of one table and other values of parameters "
                f"are not. {_ANEW}"
            )
        types = [own.dtype for own in self._exported.in_avals]
        own = [jax.numpy.asarray(a, t) for a, t in zip(leaves, types, strict=True)]
        if [leaf.dtype for leaf in own] != types:
            raise InputError(
                "expected jax_enable_x64 as it was where the program was compiled, on, but it is "
                f"off. {_ANEW}, or switch it on"
            )

        @jax.custom_vjp
        def image(leaves: list[Array]) -> Array:
            return self._call(leaves)

        def forward(leaves: list[Array]) -> Any:
            self._check_sun(leaves[sun])  # known here outside `jit`
            stand = [*leaves]
            stand[part] = jax.numpy.ones_like(leaves[part])
            return jax.vjp(self._call, stand)

        image.defvjp(forward, lambda pull, change: pull(change))
        found: Array = image(own)
        return found

    def _check_sun(self, zenith: Any) -> None:
        if not isinstance(zenith, jax.core.Tracer) and float(zenith) > self.lowest:
            raise InputError(
                f"expected a sun at most {self.lowest:g} degrees from the zenith, for which the "
                f"program has room beside the plot, but it is {float(zenith):g}. {_ANEW}"
            )

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self._exported.out_avals[0].shape))
        return f"Program of {', '.join(self.bands)}: {shape} [band, y, x]"

    def to_bytes(self) -> bytes:
        """The program with its first derivative, for `from_bytes` of another process.

        **Raises:** `MissingExtraError` without flatbuffers.
        """
        require("flatbuffers", "map")
        body = bytes(self._exported.serialize(vjp_order=1))
        head = {
            "fynjax": version("fynjax"), "jax": jax.__version__, "bands": self.bands,
            "platforms": self._exported.platforms, "known": self._known, "lowest": self.lowest,
            "sha256": hashlib.sha256(body).hexdigest(),
        }  # fmt: skip
        text = json.dumps(head).encode()
        return b"".join([_MAGIC, struct.pack("<I", len(text)), text, body])

    @classmethod
    def from_bytes(cls, data: bytes) -> "Program":
        """The program that `to_bytes` gave, of the same fynjax, for the same kind of device.

        Only of who is trusted: a program is code.

        **Raises:** `InputError` for other or damaged bytes, of another version of fynjax, of a
        newer one of JAX, and for another kind of device; `MissingExtraError` without flatbuffers.
        """
        require("flatbuffers", "map")
        start = len(_MAGIC) + 4
        if not data.startswith(_MAGIC) or len(data) < start:
            raise InputError("expected the bytes of a fynjax program, but these are others")
        (size,) = struct.unpack("<I", data[len(_MAGIC) : start])
        try:
            head = json.loads(data[start : start + min(size, _LONGEST)])
            body, bands = data[start + size :], tuple(map(str, head["bands"]))
            whole = hashlib.sha256(body).hexdigest() == head["sha256"]
            known, made, by = (str(head[name]) for name in ("known", "fynjax", "jax"))
            platforms = [str(name) for name in head["platforms"]]
            lowest = float(head["lowest"])
        except (ValueError, KeyError, TypeError):
            whole = False
        if not whole:
            raise InputError(f"expected a whole fynjax program, but its bytes are damaged. {_ANEW}")
        if made != version("fynjax"):
            own = version("fynjax")
            raise InputError(f"expected a program of fynjax {own}, but got one of {made}. {_ANEW}")
        if jax.default_backend() not in platforms:
            raise InputError(
                f"expected a program for {jax.default_backend()}, but it is one for "
                f"{', '.join(platforms)}. {_ANEW} on such a machine"
            )
        try:
            exported = export.deserialize(bytearray(body))
        except Exception as error:  # what JAX raises of another version is not documented
            raise InputError(
                f"expected a program that JAX {jax.__version__} reads, but JAX {by} made this one. "
                f"{_ANEW}"
            ) from error
        return cls(exported, bands, known, lowest)


def compile(
    scene: Scene, sensor: str | Path | Sensor, *, gradient: bool = False, **options: Any
) -> Program:
    """The image of a sensor over a scene as a program that is compiled now, not when it is first
    asked for, and that can be kept for other processes (`Program.to_bytes`).

    **Arguments:** `scene`, `sensor`, and `options` as of `fx.observe`, without noise, and without
    parameters, which each call has; `gradient`: whether its derivative is compiled too.

    **Returns:** a `Program`, which gives the reflectance of this scene and of every one of the same
    shapes: other parameters, and another seed of the same table. Over an open scene there is room
    for a sun that stands 5 degrees lower, or for what the margin of `accuracy` was stated for.

    **Raises:** `InputError` as `fx.observe`, and for other options.

    >>> import fynjax as fx
    >>> from fynjax.canopy import table1_2006
    >>> scene = fx.Scene.from_table(table1_2006()[:2], size=1.0, voxel=0.25, structure="even")
    >>> program = fx.compile(scene, "mavic_3m", pixel=0.25)
    >>> program
    Program of green, red, red_edge, nir: 4 x 4 x 4 [band, y, x]
    >>> kept = program.to_bytes()  # pathlib.Path("plot.program").write_bytes(kept)
    >>> bool((fx.Program.from_bytes(kept)(scene) == program(scene)).all())
    True
    """
    check_known(scene=scene)
    for name in ("parameters", "noise", "seed"):
        if name in options:
            raise InputError(f"expected no `{name}` of a program: each call has its parameters")
    aimed, _ = aimed_at(scene, sensor, **options)
    leaves, known, *_ = _given(scene, None)
    record = _record(scene, None)
    arrays, rest = eqx.partition(record, eqx.is_array)
    tree = jax.tree.structure(arrays)

    def image(leaves: list[Array]) -> Array:
        plot, parameters = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
        return _observe_with(aimed, plot, parameters, None).reflectance

    exported, names = export.export(jax.jit(image))(leaves), aimed.sensor.bands.names
    program = Program(exported, names, known, _lowest(scene, **options))
    jax.block_until_ready(program(scene))
    if gradient:
        jax.block_until_ready(jax.grad(lambda p: program(scene, p).sum())(scene.parameters))
    return program


def _lowest(scene: Scene, accuracy: Accuracy | None = None, **_: Any) -> float:
    """Zenith angle of the lowest sun that a program has room for [degrees]."""
    if scene.boundary != "open" or (accuracy is not None and accuracy.margin is not None):
        return 90.0
    return max(lowest_sun(scene.parameters), float(scene.parameters.light.sun_zenith))


def _record(scene: Scene, parameters: PlotParameters | None) -> tuple[Scene, PlotParameters]:
    """A scene without its parameters, and the parameters, each of one type: all that its image
    follows from."""
    parameters = _checked(scene, parameters)
    parameters = jax.tree.map(lambda x: jax.numpy.asarray(x, scene.dtype), parameters)
    return scene.unnamed(), parameters


def _given(scene: Scene, parameters: PlotParameters | None) -> tuple[list[Any], str, int, int]:
    """The arrays that a program takes, a hash of all else that it follows from, and which of the
    arrays says where the sun is, and which whether plants stand in part."""
    check_known(terrain=scene.terrain)
    arrays, rest = eqx.partition(_record(scene, parameters), eqx.is_array)
    known = hashlib.sha256(f"{jax.tree.structure(arrays)} {jax.tree.leaves(rest)}".encode())
    if scene.terrain is not None:  # by which cameras are aimed
        known.update(np.asarray(scene.terrain, float).tobytes())
    paths, leaves = zip(*jax.tree_util.tree_leaves_with_path(arrays), strict=True)
    names = [jax.tree_util.keystr(path) for path in paths]
    sun, part = (names.index(name) for name in ("[1].light.sun_zenith", "[0].in_part"))
    return [*leaves], known.hexdigest(), sun, part
