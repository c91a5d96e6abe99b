"""`python -m tests.fuzz [--minutes 60 | --each N | --bugs] [--reader NAME] [--seed N]`."""

import argparse
import math
import sys
from pathlib import Path


def main() -> int:
    from tests.fuzz.bugs import study
    from tests.fuzz.readers import READERS
    from tests.fuzz.run import fuzz

    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--reader", action="append", choices=list(READERS), help="all of them")
    parser.add_argument("--each", type=int, help="tries of each reader, whatever time they take")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, default=Path("fuzz"), help="inputs that broke")
    parser.add_argument(
        "--bugs", action="store_true", help="are bugs found that are put in on purpose?"
    )
    options = parser.parse_args()
    if options.bugs:
        return int(study(options.each or 200, options.seed) > 0)
    readers = options.reader or list(READERS)
    counts, broken = fuzz(
        readers, options.seed, save=options.save, each=options.each,
        seconds=60 * options.minutes if options.each is None else math.inf,
    )  # fmt: skip
    for outcome in broken:
        print(f"{outcome.reader} {outcome.number}: {outcome.text}")
    kinds = ("refused", "accepted", "other")
    print(f"{'reader':<20}{'tried':>9}{'refused clearly':>17}{'accepted':>10}{'other':>7}")
    total = sum(counts.values(), start=type(counts[readers[0]])())
    for name, count in [*counts.items(), ("all", total)]:
        refused, accepted, other = (count[kind] for kind in kinds)
        print(f"{name:<20}{count.total():>9}{refused:>17}{accepted:>10}{other:>7}")
    return int(total["other"] > 0)


if __name__ == "__main__":
    sys.exit(main())
