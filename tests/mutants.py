"""Faults of one line, put into the package one at a time: the tests named must find each of them.

`python -m tests.mutants [--group NAME] [--like TEXT] [--list]` copies the package, changes a line,
runs the tests that should fail, and prints the faults that survive. It ends with the status 1 where
one does. What no test finds is a claim without a guard.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
_PATIENCE = 600.0
"""Seconds after which tests count as failed: a fault may let a loop go on."""


class Mutant(NamedTuple):
    """A change of one place in a file of the package."""

    file: str
    """From the package's folder."""
    old: str
    """Text that stands there once."""
    new: str
    tests: str
    """File, or file and words of `pytest -k` after a blank, that must fail."""


_USERS = "cli/test_users_files.py"
_STORE = "test_store.py"
_LEAVES = "assembly/test_leaf_spectra.py"
_MACHINE = "cli/test_this_machine.py"
_STRICT = "io/test_strict.py"
_SHOWN = "report/test_shown.py"
_OPTIONS = "cli/test_signatures.py"
_BOMBS = "io/test_bombs.py"
_ALIKE = "fuzz/test_fuzz.py alike and"

GROUPS: dict[str, list[Mutant]] = {
    "files": [
        Mutant("io/text/_earlier.py", "same = path.is_file() and file_hash(path) == "
               "self.hashes[name]", "same = path.is_file()", _USERS),
        Mutant("io/text/_earlier.py", 'elif record["hash"] != sealed(record):', "elif False:",
               _USERS),
        Mutant("io/text/_earlier.py", 'elif record["command"] != command:', "elif False:", _USERS),
        Mutant("io/text/_earlier.py", 'elif not all(map(_is_inside, record["hashes"])):',
               "elif False:", _USERS),
        Mutant("io/text/_earlier.py", "if path.is_symlink():\n            return \"it is a link\"",
               "if False:\n            return \"it is a link\"", _USERS),
        Mutant("cli/_runtime.py", "if _ways(path) & inputs and os.path.lexists(path):",
               "if False:", _USERS),
        Mutant("cli/_runtime.py", "[*_stated_files(), *self._read]))", "_stated_files()))", _USERS),
        Mutant("cli/_runtime.py", 'path = folder.with_name(f".{folder.name}.lock")',
               'path = Path(os.environ.get("XDG_CACHE_HOME", "/tmp")) / "fynjax.lock"', _USERS),
        Mutant("cli/_options.py", "if not str(text).strip():", "if False:", _USERS),
        Mutant("_core/dry_run.py", "checks.pop()(files)", "checks.pop()", _USERS),
        Mutant("io/text/_atomic.py", "free.mkdir()  #", "pass  #", "io/test_netcdf.py staged"),
        Mutant("io/text/_atomic.py", "if why is None and may_be_limited(error):", "if False:",
               f"{_MACHINE} larger"),
    ],
    "kept": [
        Mutant("_core/store.py", 'name = f"{self._kind}\\0{key}\\0".encode()',
               'name = f"{self._kind}\\0".encode()', _STORE),
        Mutant("_core/store.py", 'if os.name == "posix" and status.st_mode & 0o077:', "if False:",
               _STORE),
        Mutant("_core/store.py", "os.utime(path)  #", "pass  #", _STORE),
        Mutant("_core/store.py", "if not stat.S_ISDIR(status.st_mode) or not _is_own(status):",
               "if False:", _STORE),
        Mutant("_core/store.py", "if held <= self._largest:", "if True:", _STORE),
        Mutant("_core/store.py", 'total.update(file.relative_to(package).as_posix().encode() + '
               'b"\\0" + content)', "total.update(content)", _STORE),
        Mutant("_core/compiler.py", 'if Path(path) == cache_folder() / "jax":', "if False:",
               _STORE),
        Mutant("_core/compiler.py", '_SUMS.put(key, b"right")', "pass", "jobs/test_doctor.py"),
        Mutant("_core/checkpoint.py", 'f"{self._signature}/{name}\\n"', 'f"{self._signature}/\\n"',
               _STORE),
        Mutant("_core/checkpoint.py", 'f"{self._signature}/{name}\\n"', 'f"{name}\\n"', _STORE),
        Mutant("_core/checkpoint.py", "if work.is_symlink():", "if False:", _STORE),
        Mutant("_core/checkpoint.py", "add((code_hash(), signed))", "add(signed)", _STORE),
        Mutant("_core/checkpoint.py", "return [*value.keys(), *value.values()]",
               "return [*value.values()]", _STORE),
        Mutant("_core/checkpoint.py", "return [value.func, value.args, value.keywords]",
               "return [value.func, value.args]", _STORE),
        Mutant("_core/checkpoint.py", "return [*names, *(cell.cell_contents for cell in cells)]",
               "return names", _STORE),
        Mutant("_core/checkpoint.py", 'total.update(f"{array.dtype}{array.shape}".encode() + '
               "array.tobytes())", "total.update(array.tobytes())", _STORE),
        Mutant("assembly/_leaf_spectra.py", "return found if inside and known and plain else None",
               "return found", _LEAVES),
        Mutant("assembly/_leaf_spectra.py", "code_hash(*_CODE), how,", "how,", _LEAVES),
        Mutant("assembly/_leaf_spectra.py", 'for sentence in found["said"]:', "for sentence in []:",
               _LEAVES),
    ],
    "options": [
        Mutant("cli/_signatures.py", "if argument.arg not in texts:", "if False:", _OPTIONS),
        Mutant("cli/_signatures.py", "usual.get(one.name, one.default)", "one.default", _OPTIONS),
        Mutant("cli/_signatures.py", '{"ge": "least", "le": "most"}',
               '{"ge": "most", "le": "least"}', _OPTIONS),
        Mutant("cli/_doors.py", 'not in ("DEFAULT", "DEFAULT_MAP")', "not in ()", _OPTIONS),
        Mutant("cli/_doors.py", "record.usual | own", "own", _OPTIONS),
        Mutant("cli/_doors.py", "if fields or record.needed:", "if fields:",
               "cli/test_validate.py bad_input"),
        Mutant("cli/_doors.py", "{**command.optional} | _stated(ctx, given)",
               "_stated(ctx, given)", _OPTIONS),
        Mutant("cli/_doors.py", "options.naming_options(argument.text, flags)", "argument.text",
               _OPTIONS),
        Mutant("cli/_options.py", 'name.removesuffix("s") if argument.kind.repeated else name',
               "name", _OPTIONS),
        Mutant("cli/_options.py", r're.search(r"\d-\d", help)', "True", _OPTIONS),
        Mutant("cli/_options.py", 'f"{flag}/--no-{flag[2:]}"', "flag", _OPTIONS),
        Mutant("__main__.py", "is None:", "is not None:", "cli/test_cli.py without_the_packages"),
    ],
    "strict": [
        Mutant("_core/records.py", "return Refused(value) if isinstance(value, bool) or odd else "
               "value", "return Refused(value) if odd else value", _STRICT),
        Mutant("_core/records.py", "return Refused(value) if isinstance(value, bool) or odd else "
               "value", "return Refused(value) if isinstance(value, bool) else value", _STRICT),
        Mutant("cli/_doors.py", "if is_odd_number(text):", "if False:", _STRICT),
        Mutant("cli/_options.py", "any(map(is_odd_number, parts))", "False", _STRICT),
        Mutant("io/text/_cells.py", "cells = table.rename(columns=_as_text)",
               "cells = table.copy()", _STRICT),
        Mutant("io/text/_cells.py", r"[=+\-@\t\r\n\uff1d", r"[=+\-@\n\uff1d", _STRICT),
        Mutant("io/text/_cells.py", r"\n\uff1d\uff0b\uff0d\uff20]", "]", _STRICT),
        Mutant("io/text/_bounds.py", "or (isinstance(value, str) and is_odd_number(value))",
               "", f"{_STRICT} every_format"),
        Mutant("io/text/_earlier.py", "read = stat.S_ISREG(state.st_mode) and",
               "read = stat.S_ISREG(state.st_mode) or", "cli/test_users_files.py device"),
        Mutant("report/figures/_style.py", "text.set_parse_math(False)", "pass",
               "report/test_figures.py dollars"),
        Mutant("_core/files.py", "if len(os.fsencode(longest)) > _LONGEST_NAME:", "if False:",
               f"{_MACHINE} too_long"),
    ],
    "bounds": [
        Mutant("canopy/mesh/_bounds.py", "if suffix is not None:", "if False:",
               "canopy/test_mesh.py packed"),
        Mutant("canopy/mesh/_bounds.py", 'if "bufferView" not in one or "sparse" in one',
               "if False", "canopy/test_mesh.py glb_has"),
        Mutant("canopy/mesh/_bounds.py", "if len(children) != len(set(children)):", "if False:",
               "canopy/test_mesh.py glb_has"),
        Mutant("canopy/mesh/_bounds.py", "if count > MOST_TRIANGLES:", "if False:",
               "canopy/test_mesh.py glb_has"),
        Mutant("canopy/mesh/_read.py", "or len(way) > len(above)", "or len(way) > 99",
               "canopy/test_mesh.py stand_deep"),
        Mutant("_core/tables.py", "if letters > _LARGEST_WORKBOOK:", "if False:",
               f"{_BOMBS} long_text"),
        Mutant("io/plot/_crowns.py", "> _MOST_COVER:", "> 1e9:", f"{_BOMBS} cover"),
        Mutant("io/raster/_zarr.py", "if count > _MOST_CHUNKS:", "if False:", f"{_BOMBS} states"),
        Mutant("io/raster/_zarr.py", 'if codec == "blosc" and', "if False and",
               f"{_BOMBS} cut_short"),
        Mutant("io/spectra/_record.py", "if not 0.0 <= lowest <= highest <= _LONGEST:",
               "if highest > _LONGEST:", f"{_BOMBS} wavelengths"),
        Mutant("canopy/mesh/_read.py", r"usemtl[ \t](.*)", r"usemtl[ \t]+(.*?)[ \t]*\r?$",
               f"{_BOMBS} no_time"),
        Mutant("io/text/_toml.py", "if deep := _DEEP.search(text):", "if deep := None:",
               f"{_STRICT} many_parts"),
        Mutant("io/text/_toml.py", r"""|"(?:[^"\\\n]|\\.)*"|""", "|", f"{_BOMBS} quoted"),
        Mutant("io/raster/_zarr.py", "return at + 4 * (flags >> 2 & 1) >= whole",
               "return True", f"{_BOMBS} zstd"),
        Mutant("io/raster/_zarr.py", "(1 if block >> 1 & 3 == 1 else block >> 3)", "(block >> 3)",
               f"{_BOMBS} zstd"),
        Mutant("io/text/_bounds.py", "for (name,) in [*views, *made]:", "for (name,) in made:",
               f"{_BOMBS} geopackage"),
        Mutant("io/text/_bounds.py", "[*views, *made]", "views", f"{_BOMBS} geopackage"),
        Mutant("_core/memory.py", "found.append(limit - free * used)", "found.append(limit)",
               f"{_BOMBS} group"),
        Mutant("_core/memory.py", "for one in (root / path.strip(\"/\") / \"end\").parents:",
               "for one in [root / path.strip(\"/\")]:", f"{_BOMBS} group"),
        Mutant("_core/memory.py", "resource.setrlimit(kind, (limit, most))", "pass",
               f"{_BOMBS} netcdf"),
        Mutant("_core/memory.py", "resource.setrlimit(kind, cls.before)", "pass",
               f"{_BOMBS} trimesh"),
        Mutant("_core/memory.py", "if cls.users == 0:\n                    resource.setrlimit",
               "if True:\n                    resource.setrlimit", f"{_BOMBS} threads"),
        Mutant("canopy/_angles.py", "powers = jnp.where(weight > 0, powers, -jnp.inf)", "pass",
               "scene/test_leaf_angle.py one_way"),
        Mutant("inversion/_found.py", "own.start(chain)", "own.start(0)",
               "inversion/test_places.py own_for_each"),
        Mutant("inversion/_found.py", "candidates(scene, settings, chain)",
               "candidates(scene, settings, 0)", "inversion/test_places.py own_for_each"),
        Mutant("terrain/_cloud.py", "check_fits(count * (2 * size + _POINT)", "check_fits(0",
               f"{_BOMBS} points"),
        Mutant("_core/files.py", "file.read(min(largest, path.stat().st_size) + 1)",
               "file.read(largest + 1)", f"{_BOMBS} wide_sheet"),
    ],
    "read": [
        Mutant("terrain/_cloud.py", "table.columns(list(places.values()))",
               "table.columns(sorted(places.values()))", f"{_ALIKE} cloud-csv"),
        Mutant("terrain/_cloud.py", "for axis in (las.x, las.y, las.z))",
               "for axis in (las.y, las.x, las.z))", "fuzz/test_fuzz.py others_are_seen"),
        Mutant("io/spectra/_envi.py", "np.where((values == ignore) | ~good, np.nan, values)",
               "np.where((values / scale == ignore) | ~good, np.nan, values)",
               f"{_ALIKE} envi-library"),
        Mutant("io/raster/_blocks.py", "*ordered_axes(values, [data, *around])",
               "*[ordered_axes(values, [data, *around])[i] for i in (1, 0, 2)]",
               "io/test_blocks.py"),
        Mutant("io/raster/_reader.py", "values += offset", "values -= offset",
               f"{_ALIKE} cube-geotiff"),
        Mutant("io/raster/_reader.py", "if t.is_identity or t.e < 0:", "if True:",
               f"{_ALIKE} cube-geotiff"),
        Mutant("compare/_spectra.py", "and not _BESIDE.search(c[0])]", "]",
               "compare/test_spectra.py flags"),
        Mutant("compare/_spectra.py", 'named.sort(key=lambda one: one[0].lower() != "reflectance")',
               "named.sort(key=lambda one: 0)", "compare/test_spectra.py flags"),
        Mutant("io/instruments/_lidar_cloud.py", "cloud.gps_time = returns.time",
               "cloud.gps_time = returns.time[::-1]", "frozen/test_frozen.py simulate"),
        Mutant("report/figures/_image.py", 'values, origin="lower", extent=extent',
               'values, origin="upper", extent=extent', "frozen/test_frozen.py render"),
    ],
    "physics": [
        Mutant("sensors/lidar/_beams.py", "mirror / geometry.used_share - 1.0", "mirror - 1.0",
               "sensors/test_lidar_systems.py"),
        Mutant("sensors/lidar/_beams.py", "-across * np.tan(turn), time", "0.0 * across, time",
               "sensors/test_lidar_systems.py"),
        Mutant("jobs/_information_flight.py", "(of_frame + shared)", "of_frame",
               "jobs/test_information_flight.py identical"),
        Mutant("jobs/_simulate_angles.py", "np.diff(np.sin(edge) ** 2)", "np.diff(np.sin(edge))",
               "jobs/test_simulate_angles.py photons"),
        Mutant("radiation/_reduced.py", "1 if pattern.ndim == 2 else min(materials, count)", "1",
               "radiation/test_reduced.py all_that_differ"),
        Mutant("inversion/_canopy.py", "CanopyView(sun_zenith, view_zenith, relative_azimuth, ",
               "CanopyView(sun_zenith, view_zenith, 0.0 * relative_azimuth, ",
               "inversion/test_canopy.py to_the_side"),
        Mutant("compare/_spectral.py",
               "real_fwhm=real.fwhm,\n        simulated_fwhm=simulated.fwhm,",
               "real_fwhm=simulated.fwhm,\n        simulated_fwhm=real.fwhm,",
               "compare/test_spectra.py widths_of_bands"),
        Mutant("scene/_parameters.py", 'sd=0.25,\n        distribution="logit-normal",\n        '
               "shared=OF_A_PLOT,", 'sd=0.25,\n        distribution="logit-normal",',
               "inversion/test_space.py traits_of_leaves"),
        Mutant("scene/_planting.py", "generator(seed, 109, species)", "generator(seed, 109)",
               "scene/test_leaf_variants.py draw_their"),
        Mutant("inversion/_views.py", "np.linalg.cholesky(covariance + by_factors @ by_factors.T)",
               "np.linalg.cholesky(covariance)", "inversion/test_views.py informative_directions"),
        Mutant("inversion/_views.py", "of_factors[:, size > _TOLD]", "of_factors[:, :2]",
               "inversion/test_views.py take_no_direction"),
        Mutant("inversion/_views.py", "np.concatenate([of_factors, vectors[:, :most]], axis=1)",
               "vectors[:, :most]", "inversion/test_other_truth.py in_its_intervals"),
        Mutant("inversion/_posterior.py", "flat[random.integers(0, len(flat), self._predictive)]",
               "flat[: self._predictive]", "inversion/test_posterior.py predictions_are"),
        Mutant("inversion/_posterior_result.py", "[discard + thin - 1 :: thin]",
               "[discard::thin]", "inversion/test_posterior.py moves_of"),
        Mutant("inversion/_posterior_result.py", "own = list(taxa if whole else place)",
               "own = list(place)", "inversion/test_posterior.py species_are"),
        Mutant("_core/sampling.py", "if not np.allclose(again, last.log_prob, rtol=1e-3, "
               "atol=1e-2):", "if False:", "inversion/test_posterior.py goes_on_as_if"),
        Mutant("inversion/_solvers.py", "jaxopt.ArmijoSGD | jaxopt.BFGS",
               "jaxopt.Broyden | jaxopt.BFGS", "inversion/test_fit.py no_solver"),
        Mutant("leaf/_problem.py", "not np.array_equal(grid, centres)", "not own.all()",
               "leaf/test_fit.py bands_that_all"),
    ],
    "flight": [
        Mutant("sensors/_pose.py", "sr * sp * cy - cr * sy, -sr * cp",
               "sr * sp * cy + cr * sy, -sr * cp", "sensors/test_pose.py"),
        Mutant("sensors/_pose.py", "lower = -cp * sy, -cp * cy, -sp",
               "lower = -cp * sy, -cp * cy, sp", "sensors/test_pose.py"),
        Mutant("sensors/_pose.py", "cr * sp * sy - sr * cy, cr", "cr * sp * sy + sr * cy, cr",
               "sensors/test_pose.py"),
        Mutant("sensors/_pose.py", "np.arctan2(-right_up, -axis_up)",
               "np.arctan2(right_up, -axis_up)", "sensors/test_pose.py aircraft"),
        Mutant("io/captures/_view.py", 'turn *= Rotation.from_euler("Y", 90.0, degrees=True)',
               'turn *= Rotation.from_euler("Y", -90.0, degrees=True)',
               "io/test_frames.py gimbals_axis"),
        Mutant("io/frames/_shot.py", "turn, scale = turned - own, longer / unit",
               "turn, scale = own - turned, longer / unit", "io/test_frames.py another_grid"),
        Mutant("io/captures/_lens.py", "missed = placed - self.lens.distorted(sight)[0]",
               "missed = 0.0 * placed", "io/test_frames.py maker_lays"),
        Mutant("io/captures/_lens.py", "-1) @ self.homography.T",
               "-1) @ np.linalg.inv(self.homography).T", "io/test_frames.py maker_lays"),
        Mutant("jobs/_reflectance.py", "key=lambda band: not _stays(band.registration)",
               "key=lambda band: _stays(band.registration)",
               "jobs/test_flight_pictures.py raw_pictures"),
        Mutant("io/frames/_lay.py", "moved.places(pixels)) - np.asarray(self.corner)",
               "moved.places(pixels)) + np.asarray(self.corner)",
               "jobs/test_flight_pictures.py does_not_show"),
        Mutant("jobs/_frames.py", "skipped[k] = error\n        _skip_others",
               "raise error\n        _skip_others", "jobs/test_flight_pictures.py are_skipped"),
        Mutant("jobs/_frames.py", "_skip_others(laid, every, names, skipped)\n        if", "if",
               "jobs/test_flight_pictures.py are_skipped"),
        Mutant("jobs/_frames.py", "np.stack([laid[k].values for k in places])",
               "np.stack([laid[k].values for k in places[::-1]])",
               "jobs/test_flight_pictures.py does_not_show"),
        Mutant("jobs/_frames.py", "float(sun.azimuth) - turn)", "float(sun.azimuth))",
               "jobs/test_flight_pictures.py sun_of_its_time"),
        Mutant("jobs/_frames.py", "tuple(sun_of[k] for k in places)",
               "tuple(sun_of[places[0]] for k in places)",
               "jobs/test_flight_pictures.py sun_of_its_time"),
        Mutant("assembly/_flights.py", "sun=stack.sun[number],", "sun=stack.sun[0],",
               "jobs/test_flight_pictures.py sun_of_its_time"),
        Mutant("assembly/_flights.py", "mask=jnp.asarray(seen),", "mask=None,",
               "jobs/test_flight_pictures.py does_not_show"),
        Mutant("inversion/_views.py", "in zip(places, jax.lax.map(seen,",
               "in zip(places[::-1], jax.lax.map(seen,", "inversion/test_flight.py is_alone"),
        Mutant("inversion/_views.py", "return bare and framed and shared(one) == shared(other)",
               "return bare and framed", "inversion/test_flight.py share_light"),
        Mutant("inversion/_factors.py", "if i == j or (name and name == names[j])", "if i == j",
               "inversion/test_data.py but_for_their_drift"),
        Mutant("inversion/_factors.py", "return own + gains.drift**2 if several and own.any() "
               "else own", "return own", "inversion/test_data.py but_for_their_drift"),
        Mutant("inversion/_search.py", "lack, len(expected.stands), kinds)",
               "lack, len(expected.stands))", "inversion/test_views.py share_their_chance"),
        Mutant("inversion/_fit_result.py", "    of_views = _correlation(laid)\n",
               "    of_views = np.eye(laid.shape[1])\n",
               "inversion/test_views.py unlike_statistics"),
        Mutant("inversion/_fit_result.py", "_shrunk(_correlation(laid.swapaxes(1, 2)), count)",
               "np.eye(laid.shape[2])", "inversion/test_views.py unlike_statistics"),
        Mutant("inversion/_fit_result.py", "max(np.mean(np.concatenate(squares)), 1.0)",
               "1.0", "inversion/test_views.py of_many_views"),
        Mutant("inversion/_search.py",
               "np.diag(np.arange(free) < len(self.space.plot.names)).astype(float)",
               "np.eye(free)", "inversion/test_views.py no_chance"),
        Mutant("inversion/_search.py", "np.asarray(before.slopes)[..., :free])",
               "np.asarray(before.slopes))[:free, :free]", "inversion/test_views.py given_the"),
        Mutant("inversion/_views.py", "slopes = slopes + by_factor @ jax",
               "slopes = slopes - by_factor @ jax", "inversion/test_flight.py of_each_alone"),
        Mutant("scene/_program.py", "jax.numpy.ones_like(leaves[part])", "leaves[part]",
               "scene/test_program.py of_one_stand"),
        Mutant("scene/_program.py", "float(zenith) > self.lowest", "False",
               "scene/test_program.py a_little_lower"),
        Mutant("scene/_program.py", "self._check_sun(leaves[sun])  # known here", "# known here",
               "scene/test_program.py a_little_lower"),
        Mutant("scene/_program.py", "if scene.terrain is not None:", "if False:",
               "scene/test_program.py another_terrain"),
        Mutant("scene/_program.py", "or shapes != asked", "",
               "scene/test_program.py number_of_plants"),
        Mutant("scene/_program.py", "known != self._known or", "",
               "scene/test_program.py number_of_plants"),
        Mutant("scene/_program.py", 'hashlib.sha256(body).hexdigest() == head["sha256"]', "True",
               "scene/test_program.py other_bytes"),
        Mutant("inversion/_found.py", "middle, high = means.mean()", "middle, high = values.mean()",
               "inversion/test_places.py uneven_chains"),
        Mutant("inversion/_found.py", "ddof=1) * (1.0 + 1.0 / len(each))", "ddof=1)",
               "inversion/test_places.py uneven_chains"),
        Mutant("inversion/_found.py", "_replace(chain=chain)", "_replace(chain=0)",
               "inversion/test_places.py own_for_each"),
        Mutant("inversion/_found.py", "(1.0 + within / between) ** 2", "1000",
               "inversion/test_places.py few_chains"),
        Mutant("inversion/_places.py", "np.maximum(settings.elements, own // 4)",
               "np.maximum(settings.elements, 0 * own)", "inversion/test_places.py a_quarter"),
        Mutant("inversion/_places.py", " / np.asarray(scene.branches)", "",
               "inversion/test_places.py one_crown"),
        Mutant("inversion/_places.py", 'get(mode="fill", fill_value=0.0)', "get()",
               "inversion/test_places.py few_of_the"),
        Mutant("inversion/_places.py", "owner[: len(index)] = mine[index]",
               "owner[: len(index)] = mine[index][::-1]", "inversion/test_places.py few_of_the"),
        Mutant("inversion/_places.py", "chance=self.chance[chosen],", "",
               "inversion/test_places.py few_of_the"),
        Mutant("inversion/_stands.py", "while len(standing) > self.most:", "while False:",
               "inversion/test_places.py few_of_the"),
        Mutant("inversion/_places.py", "inside * voxels.structure", "voxels.structure",
               "inversion/test_places.py heights_are"),
        Mutant("app/io/plot/_place.py", "plot.sun_table.position(turn)",
               "plot.sun_table.position(-turn)", "io/test_grid_north.py north_of_the_maps"),
        Mutant("inversion/_fit_result.py", "factor = np.exp(-away *", "factor = np.exp(0 * away *",
               "inversion/test_views.py of_many_views"),
        Mutant("canopy/_angles.py", "jnp.maximum(variance, 1e-6)\n    return tilt",
               "jnp.maximum(variance, 1e-6) ** 0.5\n    return tilt",
               "canopy/test_angles.py slope_by_the_mean"),
        Mutant("scene/_optics.py", "jnp.asarray(mean)[jnp.array(of)]",
               "jnp.asarray(mean)[jnp.array(of[::-1])]", "scene/test_leaf_angle.py of_their_form"),
        Mutant("scene/_structure.py", "(scene.species, parameters.species.leaf_angle)",
               "(scene.species)", "scene/test_leaf_angle.py flat_leaves"),
    ],
    "slopes": [
        Mutant("radiation/_ordinates.py", "tuple(-s for s in level)", "tuple(s for s in level)",
               "radiation/test_shift.py"),
        Mutant("radiation/_ordinates.py", "along[..., -1] -= np.maximum(-share, 0)",
               "along[..., -1] -= np.maximum(share, 0)", "radiation/test_shift.py"),
        Mutant("radiation/_ordinates.py", "part(padded, 2) * np.maximum(-share, 0)",
               "part(padded, 1) * np.maximum(-share, 0)", "radiation/test_shift.py"),
        Mutant("scene/_observe.py", "jnp.asarray(not moves)", "jnp.asarray(False)",
               "scene/test_one_backward.py"),
        Mutant("scene/_scene.py", '"cover_definition", "flowering"\n        rules',
               '"cover_definition"\n        rules', "scene/test_one_backward.py is_kept"),
        Mutant("inversion/_views.py", "sun[1] % 360.0", "sun[1]",
               "inversion/test_views.py west_of_north"),
        Mutant("scene/_observe.py", "            within_bounds(parameters, scene.taxa)\n", "",
               "scene/test_sensing.py known_is_checked"),
        Mutant("scene/_observe.py", "check_air(air, parameters.light",
               "check_air(None, parameters.light",
               "scene/test_sensing.py known_is_checked"),
        Mutant("scene/_observe.py", "isinstance(key, int | np.integer) else key",
               "isinstance(key, str) else key",
               "scene/test_sensing.py compile_nothing"),
        Mutant("scene/_planting.py", "least = self.sizes[0] + 1,", "least = self.sizes[0],",
               "scene/test_truth.py room"),
        Mutant("scene/_scene.py", 'taxon="", groups=0.0', 'taxon=one.taxon, groups=0.0',
               "scene/test_one_backward.py other_taxa"),
        Mutant("scene/_observe.py", "_light = as_one(solve_light, inline=False)",
               "_light = as_one(solve_light)", "scene/test_one_backward.py a_second"),
        Mutant("scene/_observe.py", "_nothing(value, some[0]) if own is None else own",
               "jnp.zeros_like(value) if own is None else own", "scene/test_one_backward.py"),
    ],
    "figures": [
        Mutant("report/figures/_maps.py", 'zip(cells, maps.values()):\n        label',
               'zip(cells, [(b, a, *c) for a, b, *c in maps.values()]):\n        label', _SHOWN),
        Mutant("report/figures/_maps.py", "np.ma.masked_invalid(values)",
               "np.ma.masked_invalid(values)[::-1]", _SHOWN),
        Mutant("report/figures/_maps.py", "np.ma.masked_invalid(values)",
               "np.ma.masked_invalid(values)[:, ::-1]", _SHOWN),
        Mutant("report/figures/_maps.py", '("#8A8A85", "#1B6B4A"), ("map", "emcee")',
               '("#8A8A85", "#1B6B4A"), ("emcee", "map")', _SHOWN),
        Mutant("report/figures/_maps.py", "axes.set_ylim(len(pixels) - 0.5, -0.5)",
               "axes.set_ylim(-0.5, len(pixels) - 0.5)", _SHOWN),
        Mutant("report/figures/_image.py", "colour, filled = _SHOWN_BY.get(title, (BEFORE, True))\n"
               "            share", "colour, filled = _SHOWN_BY.get({'real': 'after', 'after': "
               "'real'}.get(title, title), (BEFORE, True))\n            share", _SHOWN),
        Mutant("report/figures/_image.py", 'values, origin="lower", extent=extent',
               'values, origin="upper", extent=extent', _SHOWN),
        Mutant("report/figures/_image.py", "rgb(colour) for colour in colours]",
               "rgb(colour) for colour in colours[::-1]]", _SHOWN),
        Mutant("report/figures/_terrain.py", "axes[1].imshow(canopy,",
               "axes[1].imshow(canopy[::-1],", _SHOWN),
        Mutant("report/figures/_terrain.py", 'show: dict[str, Any] = {"origin": "lower"',
               'show: dict[str, Any] = {"origin": "upper"', _SHOWN),
        Mutant("report/figures/_terrain.py", "east * towards[0] - north * towards[1]",
               "east * towards[1] - north * towards[0]", _SHOWN),
        Mutant("report/figures/_posterior.py", "np.quantile(off, [0.05, 0.5, 0.95], axis=0)",
               "np.quantile(off, [0.25, 0.5, 0.75], axis=0)", _SHOWN),
        Mutant("report/figures/_posterior.py", '"levels": (0.5, 0.9),', '"levels": (0.39, 0.5),',
               _SHOWN),
        Mutant("report/figures/_fit.py", 'axes.hlines(y + 0.16, part["q05"], part["q95"], color='
               "BLUE", 'axes.hlines(y + 0.16, part["prior_q05"], part["prior_q95"], color=BLUE',
               _SHOWN),
        Mutant("report/figures/_fit.py", 'axes.plot(part["estimate"], y + 0.16, "o", ms=4, '
               "color=BLUE)", 'axes.plot(part["prior"], y + 0.16, "o", ms=4, color=BLUE)', _SHOWN),
        Mutant("report/figures/_fit.py",
               "(table[end].to_numpy(float) - low) / wide for end in ends",
               "(table[end].to_numpy(float) - low) / wide for end in ends[::-1]", _SHOWN),
        Mutant("report/figures/_validation_spectra.py", 'shown("simulated_mean") - '
               'shown("real_mean")', 'shown("real_mean") - shown("simulated_mean")', _SHOWN),
        Mutant("report/figures/_validation_spectra.py",
               'x, y = part["real_mean"].to_numpy(float), '
               'part["simulated_mean"].to_numpy(float)',
               'y, x = part["real_mean"].to_numpy(float), '
               'part["simulated_mean"].to_numpy(float)', _SHOWN),
        Mutant("report/figures/_validation_spectra.py", 'mean, spread = shown(f"{side}_mean"), '
               'shown(f"{side}_std")', "mean, spread = shown(\"real_mean\"), "
               'shown(f"{side}_std")', _SHOWN),
        Mutant("report/figures/_validation.py", '"q1": row[f"{side}_p25"]',
               '"q1": row[f"{side}_p5"]', _SHOWN),
        Mutant("report/figures/_validation.py", "np.clip(values, -most, most), width",
               "-np.clip(values, -most, most), width", _SHOWN),
        Mutant("report/figures/_validation.py", "axes.stairs(density[0, k], edges[k], color=REAL",
               "axes.stairs(density[1, k], edges[k], color=REAL", _SHOWN),
        Mutant("report/figures/_structure.py", 'axes.imshow(values, origin="lower"',
               'axes.imshow(values, origin="upper"', _SHOWN),
        Mutant("report/figures/_structure.py", "for side in comparison.sides.values()]",
               "for side in [*comparison.sides.values()][::-1]]", _SHOWN),
        Mutant("report/figures/_structure.py", 'axes.plot(real, simulated, "s"',
               'axes.plot(simulated, real, "s"', _SHOWN),
        Mutant("report/figures/_structure.py", "share = getattr(comparison, side).histogram / "
               "np.diff(", "share = comparison.real.histogram / np.diff(", _SHOWN),
        Mutant("report/figures/_structure.py", "getattr(comparison, side).profile, middle, color",
               "comparison.simulated.profile, middle, color", _SHOWN),
        Mutant("report/figures/_plots_inferred.py", 'some["field"],\n                    '
               'some["estimate"],', 'some["estimate"],\n                    some["field"],',
               _SHOWN),
        Mutant("report/figures/_plots_inferred.py",
               '[some["estimate"] - some["q025"], some["q975"] - some["estimate"]]',
               '[some["q975"] - some["estimate"], some["estimate"] - '
               'some["q025"]]', _SHOWN),
    ],
}  # fmt: skip
"""By what they are in."""


def _in_package(file: str) -> Path:
    """The path of a file below `fynjax`, in which those of the app are named without `app`."""
    return Path("fynjax") / ("app" if (ROOT / "fynjax" / "app" / file).is_file() else "") / file


def is_there(mutant: Mutant) -> bool:
    """Whether the text that is changed stands in its file once, and the tests are there."""
    text = (ROOT / _in_package(mutant.file)).read_text("utf-8")
    file = ROOT / "tests" / mutant.tests.split()[0]
    return text.count(mutant.old) == 1 and mutant.old != mutant.new and file.is_file()


def is_found(mutant: Mutant) -> bool:
    """Whether the tests of a mutant fail with it."""
    with tempfile.TemporaryDirectory(prefix="fynjax-mutant-") as name:
        folder = Path(name)
        shutil.copytree(ROOT / "fynjax", folder / "fynjax",
                        ignore=shutil.ignore_patterns("__pycache__"))  # fmt: skip
        for beside in ("tests", "tools", "data_schemas", "docs", "notebooks", "pyproject.toml"):
            (folder / beside).symlink_to(ROOT / beside)
        path = folder / _in_package(mutant.file)
        path.write_text(path.read_text("utf-8").replace(mutant.old, mutant.new), "utf-8")
        file, _, words = mutant.tests.partition(" ")
        line = ["-x", "-q", "-p", "no:cacheprovider", f"tests/{file}"]
        try:
            done = subprocess.run(
                [sys.executable, "-m", "pytest", *line, *(["-k", words] if words else [])],
                cwd=folder, env={**os.environ, "PYTHONPATH": str(folder)}, capture_output=True,
                text=True, check=False, timeout=_PATIENCE,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return True
    if done.returncode not in (0, 1):  # none was run, or a file cannot be read
        raise RuntimeError(f"{mutant.tests}: {done.stdout[-500:]}{done.stderr[-500:]}")
    return done.returncode != 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants")
    parser.add_argument("--group", action="append", choices=list(GROUPS), help="all of them")
    parser.add_argument("--like", default="", help="text in the file, the change or the tests")
    parser.add_argument("--list", action="store_true", help="only print them")
    parser.add_argument(
        "--unchanged",
        action="store_true",
        help="change nothing: the tests must pass, or they find what is no fault",
    )
    options = parser.parse_args()
    survivors: list[str] = []
    tried: set[str] = set()
    count = 0
    for group in options.group or list(GROUPS):
        for mutant in GROUPS[group]:
            if options.like not in " ".join(mutant):
                continue
            count += 1
            what = f"{group}: {mutant.file}: {' '.join(mutant.new.split())[:90]}"
            if options.list:
                print(what)
                continue
            began = time.monotonic()
            if options.unchanged:
                if mutant.tests in tried:
                    continue
                tried.add(mutant.tests)
                mutant, what = mutant._replace(new=mutant.old), mutant.tests
                died = not is_found(mutant)
                print(f"{'passed' if died else 'FAILED'}  {what}", flush=True)
                survivors += [] if died else [what]
                continue
            died = is_found(mutant)
            survivors += [] if died else [what]
            print(f"{'died' if died else 'SURVIVED':<9}{time.monotonic() - began:5.0f} s  {what}",
                  flush=True)  # fmt: skip
    if not options.list and not options.unchanged:
        print(f"{count - len(survivors)} of {count} died")
        for what in survivors:
            print(f"survived: {what}")
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main())
