"""Write the numbers of commands anew: `python -m tests.frozen.write [COMMAND ...]`; all but the
studies by default.

    -> NAME.json  beside this file, which `tests.frozen.test_frozen` compares with
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import tests.conftest  # noqa: F401  # compiles as tests do
from tests.frozen.cases import CASES, run

for command in sys.argv[1:] or [name for name, case in CASES.items() if case.mark != "study"]:
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        numbers = run(command, Path(folder))
    rows = [f"{json.dumps(name)}: {json.dumps(numbers[name])}" for name in sorted(numbers)]
    text = "{\n" + ",\n".join(rows) + "\n}\n"
    Path(__file__).with_name(f"{command}.json").write_text(text, "utf-8")
    print(f"{command}: {len(rows)} rows, {time.perf_counter() - start:.1f} s", flush=True)
