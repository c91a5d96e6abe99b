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
from fynjax.scene._observe import _checked, _observe_with, _with_parameters, aimed_at
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

    def __init__(self, exported: export.Exported, bands: tuple[str, ...], known: str) -> None:
        self.bands = bands
        """Names of the bands of the image."""
        self._exported, self._known = exported, known
        self._call = jax.jit(exported.call)

    def __call__(
        self, scene: Scene, parameters: PlotParameters | None = None
    ) -> Float[Array, "band y x"]:
        """Reflectance factor of a scene at `parameters`, or at its own [-].

        Differentiable once, in reverse mode (`jax.grad`, `jax.vjp`), in parameters and in the
        scene's own arrays, with its plants as they are whole or in part. In forward mode take
        `fx.observe`.

        **Raises:** `InputError` for a scene of other shapes, taxa or settings than the one that the
        program was compiled with, and for parameters as of `fx.observe`.
        """
        leaves, known = _given(scene, parameters)
        shapes = [(*np.shape(leaf),) for leaf in leaves]
        asked = [own.shape for own in self._exported.in_avals]
        if known != self._known or shapes != asked:
            what = "taxa, sides or settings" if known != self._known else "numbers of plants"
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
        found: Array = self._call(own)
        return found

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
            "platforms": self._exported.platforms, "known": self._known,
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
        return cls(exported, bands, known)


def compile(
    scene: Scene, sensor: str | Path | Sensor, *, gradient: bool = False, **options: Any
) -> Program:
    """The image of a sensor over a scene as a program that is compiled now, not when it is first
    asked for, and that can be kept for other processes (`Program.to_bytes`).

    **Arguments:** `scene`, `sensor`, and `options` as of `fx.observe` without noise; `gradient`:
    whether its derivative is compiled too.

    **Returns:** a `Program`, which gives the reflectance of this scene and of every one of the same
    shapes: other parameters, and another seed of the same table.

    **Raises:** `InputError` as `fx.observe`.

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
    aimed, _ = aimed_at(scene, sensor, **options)
    check_known(scene=scene)
    leaves, known = _given(scene, None)
    record = _record(scene, None)
    arrays, rest = eqx.partition(record, eqx.is_array)
    tree = jax.tree.structure(arrays)

    def image(leaves: list[Array]) -> Array:
        plot, parameters = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
        return _observe_with(aimed, plot, parameters, None).reflectance

    program = Program(export.export(jax.jit(image))(leaves), aimed.sensor.bands.names, known)
    jax.block_until_ready(program(scene))
    if gradient:
        jax.block_until_ready(jax.grad(lambda p: program(scene, p).sum())(scene.parameters))
    return program


def _record(scene: Scene, parameters: PlotParameters | None) -> tuple[Scene, PlotParameters]:
    """What an image follows from: the scene, and parameters of one type apart from it."""
    parameters = _checked(scene, parameters)
    parameters = jax.tree.map(lambda x: jax.numpy.asarray(x, scene.dtype), parameters)
    return _with_parameters(scene, None), parameters


def _given(scene: Scene, parameters: PlotParameters | None) -> tuple[list[Any], str]:
    """The arrays that a program takes, and a hash of all else that it follows from."""
    arrays, rest = eqx.partition(_record(scene, parameters), eqx.is_array)
    text = f"{jax.tree.structure(arrays)} {jax.tree.leaves(rest)}"
    return jax.tree.leaves(arrays), hashlib.sha256(text.encode()).hexdigest()
