#!/usr/bin/env python3
"""Checks `spharm bids` with BIDS' own tools: `./run bids` runs it, with the program as first argument.

Three artificial FreeSurfer subjects are fitted and gathered. bids-validator-deno must find no error in the derivative
dataset, and PyBIDS must find every file of every subject by its entities.
"""

import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

SUBJECTS, HEMISPHERES = ("01", "02", "03"), {"lh": "L", "rh": "R"}
#: Expected number of files of a hemisphere, by PyBIDS's entities.
EXPECTED = {
    (".npz", "spharm", None): 1,
    (".surf.gii", "spharm", "icosphere3"): 1,
    (".shape.gii", "spharmerror", None): 1,
    (".tsv", "spharmpial", None): 1,
}


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}:\n{done.stderr or done.stdout}")
    return done.stdout


def dataset(program, folder):
    """Fits and gathers the subjects; returns the derivative dataset."""
    for number, subject in enumerate(SUBJECTS):
        for place, hemisphere in enumerate(HEMISPHERES):
            surf = folder / f"data/derivatives/freesurfer/sub-{subject}/surf"
            surf.mkdir(parents=True, exist_ok=True)
            run(program, "generate", "--subdivisions", 4, "--variant", 2 * number + place, "--surface", surf / f"{hemisphere}.pial",
                "--sphere", surf / f"{hemisphere}.sphere.reg", "-q")
    out = folder / "out"
    run(program, "bids", folder / "data", out, "participant", "--max-degree", 10, "--icosphere", 3, "-q")
    run(program, "bids", folder / "data", out, "group", "-q")
    return out


def validate(out):
    """Returns the validator's errors and warnings, by code."""
    validator = Path(sys.executable).parent / "bids-validator-deno"
    done = subprocess.run([validator, "--json", out], capture_output=True, text=True)
    issues = json.loads(done.stdout)["issues"]["issues"]
    counts = {severity: Counter(issue["code"] for issue in issues if issue["severity"] == severity) for severity in ("error", "warning")}
    return counts["error"], counts["warning"]


def missing(out):
    """Returns the subjects' files that PyBIDS doesn't find by their entities, and the number of files that it finds."""
    from bids import BIDSLayout

    layout = BIDSLayout(out, validate=False, is_derivative=True)
    lost, found = [], 0
    for subject in SUBJECTS:
        for hemisphere in HEMISPHERES.values():
            for (extension, desc, space), count in EXPECTED.items():
                query = {"subject": subject, "hemi": hemisphere, "extension": extension, "desc": desc}
                files = layout.get(**query, **({"space": space} if space else {}), return_type="filename")
                found += len(files)
                if len(files) != count:
                    lost.append(f"{query}: {len(files)} in place of {count}")
    return lost, found


def main():
    program = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        out = dataset(program, Path(folder))
        errors, warnings = validate(out)
        lost, found = missing(out)
    said = ", ".join(f"{code} {count}" for code, count in warnings.items()) or "none"
    print(f"bids-validator-deno: {sum(errors.values())} errors, warnings: {said}")
    print(f"PyBIDS: {found} files of {len(SUBJECTS)} subjects found by their entities")
    for problem in [*(f"{code}: {count}" for code, count in errors.items()), *lost]:
        print(f"error: {problem}", file=sys.stderr)
    sys.exit(1 if errors or lost else 0)


if __name__ == "__main__":
    main()
