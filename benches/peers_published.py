"""Reproduces peers' published tests through spharm_rs: `./run peers published`.

Each function of the modules below takes the input of one of the peer's own tests or examples, which the first line of
its docstring names with the version or the commit of its file, and compares the peer's results with those of spharm_rs.
The largest difference, relative to the largest value of a result, must be at most 1e-10, unless a note says why not.
"""

import importlib
from importlib.metadata import version

#: For each package on PyPI, the module with its tests.
MODULES = {"pyshtools": "peers_pyshtools", "ktch": "peers_ktch", "aicsshparam": "peers_aics"}


def report():
    """Prints a table for each package and returns the number of results that miss their bar."""
    return sum(map(report_package, MODULES))


def report_package(package):
    """Prints the results of a package's tests as they are computed and returns the number of those missed."""
    try:
        tests = importlib.import_module(MODULES[package]).TESTS
        print(f"\n{package} {version(package)}: published tests through spharm_rs {version('spharm-rs')}")
    except ImportError as error:
        print(f"\n{package}: can't be imported: {error}")
        return 1
    print(f"{'quantity':<47}{'difference':>11}{'bar':>9}")
    results = []
    for test in tests:
        print(test.__doc__.splitlines()[0])
        for result in test():
            results.append(result)
            met = "met" if result.met else "MISSED"
            note = f" ({result.note})" if result.note else ""
            print(f"  {result.quantity:<45}{result.difference:>11.1e}{result.bar:>9.0e}  {met}{note}", flush=True)
    missed = sum(not result.met for result in results)
    noted = sum(bool(result.note) for result in results)
    print(f"{len(results) - missed} of {len(results)} results of {len(tests)} tests met; {noted} with another bar")
    return missed
