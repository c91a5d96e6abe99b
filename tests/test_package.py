"""The package declares what it needs, and says of itself the same everywhere."""

import ast
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import jax
import numpy as np
import pytest
import yaml
from jinja2 import Template

import fynjax
from fynjax._core import compiler

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PROJECT = PYPROJECT["project"]
OWNERS = packages_distributions()
"""Distributions behind each installed module."""


def normalised(requirement: str) -> str:
    """Name of a requirement as package registries compare it."""
    name = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert name, requirement
    return re.sub(r"[-_.]+", "-", name.group()).lower()


def undeclared(source: str, requirements: list[str]) -> set[str]:
    """Distributions whose modules `source` imports and `requirements` does not name."""
    declared = {normalised(requirement) for requirement in requirements}
    modules = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            modules |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            modules.add(node.module.split(".")[0])
    modules -= {*sys.stdlib_module_names, "fynjax"}
    return {
        module
        for module in modules
        if declared.isdisjoint(map(normalised, OWNERS.get(module, [module])))
    }


def test_what_is_imported_is_declared() -> None:
    extras = PROJECT["optional-dependencies"]
    requirements = [*PROJECT["dependencies"], *(r for extra in extras.values() for r in extra)]
    for path in (ROOT / "fynjax").rglob("*.py"):
        assert not undeclared(path.read_text("utf-8"), requirements), path


@pytest.mark.parametrize("source", ["import pytest.mark", "from pytest import mark"])
def test_an_undeclared_import_is_noticed(source: str) -> None:
    assert undeclared(source, ["numpy>=2", "py-test"]) == {"pytest"}
    assert undeclared(source, ["pytest>=8"]) == set()


def test_extras_have_the_same_bounds_among_the_tools_of_the_tests() -> None:
    bounds = {normalised(r): r for r in PYPROJECT["dependency-groups"]["test"]}
    for extra in PROJECT["optional-dependencies"].values():
        for requirement in extra:
            assert bounds.get(normalised(requirement), requirement) == requirement


def test_lowest_versions_are_stated_for_every_dependency() -> None:
    script = ROOT / ".ci" / "lowest_versions.py"
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    pinned = {normalised(line) for line in run.stdout.splitlines()}
    extras = PROJECT["optional-dependencies"].values()
    assert pinned == {normalised(r) for r in PROJECT["dependencies"]} | {
        normalised(r) for extra in extras for r in extra if not r.startswith("fynjax[")
    }
    assert all("==" in line for line in run.stdout.splitlines())


def test_one_version_everywhere() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == PROJECT["version"] == fynjax.__version__
    assert citation["license"] == PROJECT["license"]


def test_workflows_and_the_conda_recipe_can_be_read() -> None:
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        workflow = yaml.safe_load(path.read_text("utf-8"))
        assert workflow[True]  # `on`
        for job in workflow["jobs"].values():
            assert job["runs-on"]
            for step in job["steps"]:
                assert ("run" in step) != ("uses" in step)
                command = step.get("run", "").split()[0:1]
                assert all((ROOT / name).is_file() for name in command if name.startswith(".ci/"))
    recipe = Template((ROOT / "tools" / "conda" / "meta.yaml").read_text("utf-8"))
    loaded = {"load_file_data": lambda *_, **__: PYPROJECT, "PYTHON": "python"}
    described = yaml.safe_load(recipe.render(loaded))
    assert described["package"] == {"name": "fynjax", "version": PROJECT["version"]}
    needed = {line.split()[0] for line in described["requirements"]["run"]}
    stated = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["app"]]
    assert needed == {"python"} | {r.partition(">=")[0].lower() for r in stated}


def test_types_are_published() -> None:
    assert (ROOT / "fynjax" / "py.typed").is_file()
    assert "Typing :: Typed" in PROJECT["classifiers"]


def test_sums_of_products_are_right() -> None:
    """What one version of jaxlib gets wrong without a flag: shape and size matter, and threads."""
    random = np.random.default_rng(0)
    left, right = (
        random.normal(size=n).astype(np.float32) for n in ((4, 120, 120), (4, 4, 120, 120))
    )
    code = (
        "import sys, jax, numpy as np, fynjax._core\n"
        "left, right = (np.load(name) for name in sys.argv[1:])\n"
        "total = jax.jit(lambda a, b: jax.numpy.sum(a[:, None] * b, axis=0))(left, right)\n"
        "np.testing.assert_allclose(total, np.einsum('ars,abrs->brs', left, right), atol=1e-4)\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("left.npy", "right.npy")]
        for file, values in zip(files, (left, right), strict=True):
            np.save(file, values)
        # As a user's program is compiled, not as tests are.
        environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
        subprocess.run([sys.executable, "-c", code, *files], check=True, env=environment)


@pytest.mark.parametrize(
    ("installed", "stated", "set_to"),
    [
        ("0.10.1", None, list(compiler.QUICK)),
        ("0.11.0", None, list(compiler.QUICK)),
        ("0.11.1", None, list(compiler.QUICK)[:3]),
        ("0.12.0.1", None, list(compiler.QUICK)[:3]),
        ("0.13.0", None, []),
        ("0.10.1", "--theirs", ["--theirs"]),
        ("0.10.1", "", []),
        ("0.10.2", None, [*compiler.QUICK, compiler.OWN_SUMS]),
        ("0.10.2", "--theirs", ["--theirs", compiler.OWN_SUMS]),
    ],
)
def test_flags_are_those_that_the_installed_compiler_knows(
    installed: str, stated: str | None, set_to: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "version", lambda name: installed)
    monkeypatch.setattr(jax._src.xla_bridge, "backends_are_initialized", lambda: False)
    monkeypatch.setenv("XLA_FLAGS", stated or "")
    if stated is None:
        monkeypatch.delenv("XLA_FLAGS")
    compiler.set_flags()
    assert os.environ["XLA_FLAGS"].split() == set_to


def test_a_user_may_keep_jax_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "import os, fynjax.scene, jax; from fynjax._core.compiler import settings; "
        "print([os.environ.get('XLA_FLAGS'), jax.config.jax_default_matmul_precision, "
        "jax.config.jax_compilation_cache_dir]); print(settings())"
    )
    for name in ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_DEFAULT_MATMUL_PRECISION"):
        monkeypatch.delenv(name, raising=False)
    said = {}
    for value in ("on", "off"):
        monkeypatch.setenv(compiler.OFF, value)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        said[value] = done.stdout.splitlines()
    flags = compiler.OWN_SUMS if compiler.version("jaxlib") == compiler.WRONG_SUMS else None
    assert said["off"] == [str([flags, None, None]), f"none of fynjax ({compiler.OFF}=off)"]
    assert "highest" in said["on"][0]
    assert "fusion_emitters" in said["on"][0]
    assert "products of matrices: highest; programs kept in /" in said["on"][1]
    monkeypatch.setattr(compiler, "version", lambda name: "0.13.0")
    monkeypatch.delenv(compiler.OFF)
    assert (
        f"{len(compiler.QUICK)} flags left out, not tried with jaxlib 0.13.0" in compiler.settings()
    )


def test_a_graphics_card_has_flags_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiler.LEVEL in compiler.known_flags()
    monkeypatch.setattr(compiler, "find_spec", lambda name: name == "jax_plugins" or None)
    flags = set(compiler.known_flags())
    assert set(compiler.QUICK) - flags == {compiler.LEVEL}
    assert flags - set(compiler.QUICK) == set(compiler.CARD)
    assert "flags left out" not in compiler.settings()


def test_flags_of_a_card_are_known_to_the_compiler() -> None:
    """XLA ends the process where it does not know one."""
    code = "import jax; jax.numpy.ones(3).sum()"
    environment = os.environ | {"XLA_FLAGS": " ".join(compiler.CARD)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def test_a_compiler_that_sums_wrongly_and_is_in_use_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    jax.devices()
    before = os.environ["XLA_FLAGS"]
    compiler.set_flags()
    assert os.environ["XLA_FLAGS"] == before
    monkeypatch.setattr(compiler, "version", lambda name: compiler.WRONG_SUMS)
    with pytest.raises(ImportError, match=r"Import fynjax first"):
        compiler.set_flags()
    monkeypatch.setenv("XLA_FLAGS", compiler.OWN_SUMS)
    compiler.set_flags()


@pytest.mark.parametrize("first", ["jax", "fynjax._core"])
def test_a_graphics_card_multiplies_in_full_unless_its_user_says_otherwise(first: str) -> None:
    """JAX's default there keeps 10 bits of a float32, which no processor shows."""
    code = (
        f"import {first}, fynjax._core, jax\n"
        "import jax.numpy as jnp\n"
        "print(jax.make_jaxpr(lambda a: a @ a)(jnp.ones((2, 2), 'float32')))"
    )
    environment = {k: v for k, v in os.environ.items() if k != "JAX_DEFAULT_MATMUL_PRECISION"}
    for stated, found in (({}, 1), ({"JAX_DEFAULT_MATMUL_PRECISION": "bfloat16"}, 0)):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True, text=True, check=True, env=environment | stated,
        )  # fmt: skip
        assert done.stdout.count("Precision.HIGHEST") // 2 == found


def test_the_command_line_is_a_module_too() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "fynjax", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip().endswith(fynjax.__version__)


def test_compiled_programs_are_kept_from_python_too(tmp_path: Path) -> None:
    """In the user's cache; where the process or the environment says something else, there."""
    show = "import jax, fynjax.scene; print(jax.config.jax_compilation_cache_dir)"
    inherited = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    inherited["XDG_CACHE_HOME"] = str(tmp_path)

    def kept(code: str, **environment: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True, text=True, check=True, env=inherited | environment,
        )  # fmt: skip
        return done.stdout.strip()

    assert kept(show) == str(tmp_path / "fynjax" / "jax")
    elsewhere, own = str(tmp_path / "elsewhere"), str(tmp_path / "own")
    assert kept(show, JAX_COMPILATION_CACHE_DIR=elsewhere) == elsewhere
    first = f'import jax; jax.config.update("jax_compilation_cache_dir", {own!r}); '
    assert kept(first + show) == own
