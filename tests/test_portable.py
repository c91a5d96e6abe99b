"""What the package needs of a system: nothing that Windows lacks."""

import ast
import types
from pathlib import Path

import psutil

import fynjax
from fynjax._core import memory

UNIX_ALONE = {"fcntl", "grp", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty"}
OF_UNIX = {"fork", "getuid", "geteuid", "mkfifo", "sysconf", "statvfs", "uname"}
FILES = sorted(Path(fynjax.__file__).parent.rglob("*.py"))


def imported(statement):
    if isinstance(statement, ast.Import):
        return {name.name.split(".")[0] for name in statement.names}
    if isinstance(statement, ast.ImportFrom):
        return {(statement.module or "").split(".")[0]}
    return set()


def test_no_module_needs_what_only_unix_has():
    for path in FILES:
        tree = ast.parse(path.read_text("utf-8"))
        # Within a function an import may stand that only runs where the module is.
        for statement in tree.body:
            assert not imported(statement) & UNIX_ALONE, path
        of_os = {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "os"
        }
        assert not of_os & OF_UNIX, path


def test_memory_is_known(monkeypatch):
    assert 2**20 < memory.peak_memory() < memory.total_memory()
    assert 0 < memory.free_memory() < memory.total_memory()
    assert memory.peak_memory() >= psutil.Process().memory_info().rss * 0.5
    info = types.SimpleNamespace(peak_wset=7 * 2**20)  # as Windows tells it
    monkeypatch.setattr(psutil.Process, "memory_info", lambda self: info)
    assert memory.peak_memory() == 7 * 2**20
