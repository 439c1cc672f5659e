"""The in-plane displacement's figures beside their targets, and the page docs/validation/correlation.md with plots.

On exact speckle of 1.4 px and 15 % contrast, 12 bits, against pyvale (in an environment of its own) and OpenCV on the
same images. Takes about ten minutes on two quiet cores; ``--quick`` glances at everything, without the page;
``--times`` measures speed and memory anew, in a minute.
"""

from __future__ import annotations

import argparse

from correlation_study.page import target_rows, time_rows, window_of, write_page, write_times
from correlation_study.results import QUICK, Extent, measure_all, measure_times
from correlation_study.scenes import ROOT
from correlation_study.table import printed

PAGE = ROOT / "docs" / "validation" / "correlation.md"


def main() -> None:
    """Measure, print the table, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few pairs and windows, and the page stays as it is")
    parser.add_argument("--without-rivals", action="store_true", help="leave pyvale out")
    parser.add_argument("--times", action="store_true", help="measure the times alone, and write them alone")
    options = parser.parse_args()
    if options.times:
        window = window_of(PAGE)
        speeds = measure_times(Extent(), window)
        print(printed(time_rows(speeds)))
        write_times(speeds, window, PAGE)
        return
    results = measure_all(QUICK if options.quick else Extent(), with_rivals=not options.without_rivals)
    print(printed(target_rows(results) + time_rows(results.speeds)))
    if not options.quick:
        write_page(results, PAGE)
        print(f"page: {PAGE}")


if __name__ == "__main__":
    main()
