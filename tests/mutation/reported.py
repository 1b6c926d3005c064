"""A plugin of pytest that writes each test's outcome as it comes: what hangs leaves what came before."""

import os
from pathlib import Path


def pytest_runtest_logreport(report):
    """One line for each test that failed, or that was called and passed."""
    if report.failed or report.when == "call":
        outcome = "failed" if report.failed else report.outcome
        with Path(os.environ["MUTATION_REPORT"]).open("a") as file:
            file.write(f"{report.nodeid} {outcome}\n")
