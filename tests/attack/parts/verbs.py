"""Every verb that writes, with small inputs; and the guarantees on a verb's outputs, in whatever way it ended.

A verb runs in its own folder, with its inputs in `in` and its outputs in `out`. The paths are relative, so that every
folder gets the same bytes. `INPUTS` stands for the absolute path of the inputs.
"""

import dataclasses
import hashlib
import json
import math
import shutil
import struct
import zipfile

from common import HANG, run


@dataclasses.dataclass
class Verb:
    """A command, and the properties of its outputs."""

    name: str
    arguments: str
    #: Whether existing outputs are replaced only with `--force`; otherwise repeating the same command continues the
    #: work.
    force: bool = True
    #: Commands that make the files that this command extends.
    prepare: tuple = ()
    #: Whether the command continues after a failure, so that its complete outputs may differ until it is repeated.
    goes_on: bool = False
    #: Hashes of the files of an undisturbed run; `None` for a file that differs between two such runs, because it has
    #: times.
    expected: dict = dataclasses.field(default_factory=dict)
    bytes_written: int = 0
    seconds: float = 0.0

    def command(self, program, inputs_folder, again=False):
        words = self.arguments.replace("INPUTS", str(inputs_folder)).split()
        return [program, *words, *(["--force"] if again and self.force else [])]


def verbs():
    # Uses the original path of the dataset, because the result contains it.
    participant = "bids INPUTS/data out/derivative participant --surfaces pial --hemi L --max-degree 3 --icosphere 1 --threads 1"
    build = "basis-build --sphere in/sphere.ply --store out/store --max-degree 6 --threads 1 -q"
    return [
        Verb("fit", "fit --sphere in/sphere.ply --surface in/a.ply --max-degree 8 -o out/a.npz --report out/a.json "
             "--coefficients-csv --objective vertices --stderr --threads 1"),
        Verb("fit, no sphere", "fit --surface in/a.ply --max-degree 4 -o out/a.npz --threads 1"),
        Verb("fit --manifest", "fit --manifest in/list.tsv --sphere in/sphere.ply --max-degree 4 -o out/models "
             "--status out/log.status.tsv --threads 1"),
        Verb("fit --store", "fit --store in/store --sphere in/sphere.ply --surface in/a.ply --max-degree 4 -o out/a.npz "
             "--threads 1"),
        Verb("parametrize", "parametrize --surface in/a.ply -o out/s.ply --report out/s.json --threads 1"),
        Verb("reconstruct", "reconstruct --model in/a.npz in/b.npz --icosphere 2 -o out/shapes --threads 1"),
        Verb("compare", "compare in/a.ply in/b.ply -o out/error.ply --report out/error.json --threads 1"),
        Verb("picture", "picture in/a.ply in/b.ply --error --size 64 -o out/p.png"),
        Verb("generate", "generate --subdivisions 2 --surface out/x.surf.gii --sphere out/x.sphere.surf.gii"),
        Verb("generate --group", "generate --group rods --members 3 --subdivisions 1 --output-dir out/rods"),
        Verb("basis-build", build, force=False),
        Verb("basis-build zstd", build + " --codec zstd", force=False),
        Verb("basis-build factor", build + " --factor 4", force=False),
        Verb("basis-build extend", build, force=False, prepare=(build.replace("degree 6", "degree 3"),)),
        Verb("basis-build f32", build + " --dtype f32 --factor 4 --factor-dtype f32", force=False),
        Verb("moments", "moments --samples in/samples.csv --values v --max-degree 4 -o out/s.moments --report out/s.json "
             "--threads 1"),
        Verb("moments merge", "moments merge in/1.moments in/2.moments -o out/all.moments"),
        Verb("shape compress", "shape compress in/a.npz in/b.npz --tolerance 1e-3 -o out/small --threads 1"),
        Verb("shape expand", "shape expand in/a.sphz -o out/a.npz"),
        Verb("shape mean", "shape mean in/a.npz in/b.npz -o out/mean.npz --report out/mean.json --threads 1"),
        Verb("shape align", "shape align in/a.npz in/b.npz in/c.npz --group -o out/aligned --mean out/mean.npz --threads 1"),
        Verb("shape correspond", "shape correspond in/a.ply in/b.ply in/c.ply --max-degree 4 --subdivisions 2 -o out/group "
             "--threads 1"),
        Verb("shape correspond --table", "shape correspond --table in/group.tsv --guide --with near:0.2 --max-degree 4 --subdivisions 2 "
             "-o out/group --report out/group.json --warnings out/warnings.json --threads 1"),
        Verb("shape correspond --label", "shape correspond in/labels.nii in/labels-2.nii --label 1 --max-degree 2 --subdivisions 2 "
             "-o out/group --threads 1"),
        Verb("shape correspond --to", "shape correspond in/d.ply --to in/group -o out/added --threads 1"),
        Verb("shape carry", "shape carry in/group in/marks.csv --from a --to all --format csv -o out/carried"),
        Verb("shape register", "shape register in/b.ply in/c.ply --template in/a.ply -o out/registered --threads 1"),
        Verb("shape pca", "shape pca in/a.npz in/b.npz in/c.npz -o out/modes.shape-model.npz --scores out/scores.csv --threads 1"),
        Verb("shape quality", "shape quality in/a.npz in/b.npz in/c.npz --samples 20 --bands 3 --icosphere 2 -o out/quality.json "
             "--curves out/quality.png --threads 1"),
        Verb("shape quality --mask", "shape quality in/group/a.spharm.npz in/group/b.spharm.npz in/group/c.spharm.npz "
             "--mask in/group --samples 20 --bands 3 --icosphere 2 -o out/quality.json --threads 1"),
        Verb("shape test", "shape test --a in/a.npz in/b.npz --b in/c.npz in/d.npz --icosphere 1 --permutations 5 -o out/test "
             "--threads 1"),
        Verb("shape morph", "shape morph in/a.npz in/b.npz --steps 3 --icosphere 1 -o out/morph --animation out/morph.gif "
             "--threads 1"),
        Verb("shape remesh", "shape remesh in/a.npz in/b.npz --even --icosphere 2 -o out/meshes --threads 1"),
        Verb("shape rotate", "shape rotate in/a.npz in/b.npz --object 10,20,30 -o out/turned --threads 1"),
        Verb("shape measure", "shape measure in/a.npz in/b.npz -o out/measures.csv --maps out/maps --icosphere 2 --threads 1"),
        Verb("export", "export in/a.npz in/b.npz --to pyshtools -o out/sh"),
        Verb("import", "import in/a.coef -o out/a.npz"),
        Verb("report", "report in/a.npz -o out/page.html --threads 1"),
        Verb("volumes", "volumes in/labels.nii --max-degree 3 -o out/models --threads 1", goes_on=True),
        Verb("freesurfer", "freesurfer in/subjects --surface pial --hemi lh --max-degree 3 --evaluate-on icosphere:1 -o out/models "
             "--threads 1"),
        # Verbs that resume without --force.
        Verb("bids", participant, force=False, goes_on=True),
        Verb("bids group", participant.replace("participant", "group"), force=False, prepare=(participant + " -q",), goes_on=True),
        Verb("study", "study out/study.toml --threads 1", force=False, prepare=("study init out/study.toml",), goes_on=True),
    ]


def inputs(site):
    """Makes the inputs of all verbs, once."""
    folder = site.folder("inputs")
    program = site.program

    def make(*words):
        ended = run([program, *words], cwd=folder, limit=120)
        if ended.code != 0:
            raise RuntimeError(f"the inputs can't be made: {' '.join(map(str, words))}: {ended.last()}")

    make("generate", "--subdivisions", 2, "--surface", "a.ply", "--sphere", "sphere.ply")
    for variant, name in ((1, "b"), (2, "c"), (3, "d")):
        make("generate", "--subdivisions", 2, "--variant", variant, "--surface", f"{name}.ply")
    for name in "abcd":
        make("fit", "--sphere", "sphere.ply", "--surface", f"{name}.ply", "--max-degree", 6, "-o", f"{name}.npz", "-q")
    make("shape", "correspond", "a.ply", "b.ply", "c.ply", "--max-degree", 4, "--subdivisions", 2, "-o", "group", "-q")
    (folder / "marks.csv").write_text("name,x,y,z\np,30,0,0\nq,0,20,0\n")
    for name in "abc":
        # Values at the 162 vertices of an icosphere of two subdivisions.
        (folder / f"{name}.near.csv").write_text("near\n" + "".join(f"{math.sin(0.1 * v)}\n" for v in range(162)))
    rows = [f"{name}\t{name}.ply\tmarks.csv\t{name}.near.csv" for name in "abc"]
    (folder / "group.tsv").write_text("\n".join(["id\tsurface\tlandmarks\tnear", *rows]) + "\n")
    make("basis-build", "--sphere", "sphere.ply", "--store", "store", "--max-degree", 4, "--factor", 3, "-q")
    make("shape", "compress", "a.npz", "--step", "1e-4", "-o", "a.sphz", "-q")
    make("export", "a.npz", "--to", "pdm", "-o", "a.coef")
    for subject, variant in (("sub-01", 0), ("sub-02", 1)):
        surf = folder / "subjects" / subject / "surf"
        surf.mkdir(parents=True)
        make("generate", "--subdivisions", 2, "--variant", variant, "--surface", surf / "lh.pial", "--sphere", surf / "lh.sphere.reg")
    (folder / "data" / "derivatives").mkdir(parents=True)
    (folder / "data" / "derivatives" / "freesurfer").symlink_to("../../subjects")
    (folder / "list.tsv").write_text("id\tsurface\nfirst\ta.ply\nsecond\tb.ply\n")
    (folder / "samples.csv").write_text(samples())
    for part in "12":
        make("moments", "--samples", "samples.csv", "--values", "v", "--max-degree", 3, "--shard", f"{int(part) - 1}/2", "-o",
             f"{part}.moments", "-q")
    for name in ("labels.nii", "labels-2.nii"):
        (folder / name).write_bytes(nifti())
    for variant in range(4):
        make("generate", "--subdivisions", 2, "--variant", variant, "--surface", f"s{variant}.ply")
    rows = [f"s{variant},s{variant}.ply,{'ab'[variant // 2]}" for variant in range(4)]
    (folder / "study.csv").write_text("\n".join(["id,surface,group", *rows]) + "\n")
    return folder


def learned(site):
    """Returns the folder of the inputs, and all verbs with the outputs of their undisturbed runs; computed once."""
    if site.learned is None:
        folder, found = inputs(site), verbs()
        place = Workplace(site, "undisturbed", folder)
        for verb in found:
            place.learn(verb)
        site.learned = folder, found
    return site.learned


def samples(rows=400):
    """Returns a table of samples of a function on a spiral."""
    lines = ["x,y,z,v"]
    for i in range(rows):
        z = 1 - (2 * i + 1) / rows
        r, phi = math.sqrt(1 - z * z), 2.4 * i
        lines.append(f"{r * math.cos(phi)},{r * math.sin(phi)},{z},{math.sin(3 * z)}")
    return "\n".join(lines) + "\n"


def nifti(size=12):
    """Returns a NIfTI volume with two labels, a cube and a ball."""
    header = struct.pack("<i36x", 348) + struct.pack("<8h", 3, size, size, size, 1, 1, 1, 1) + bytes(14)
    header += struct.pack("<hhh", 2, 8, 0) + struct.pack("<8f", 1, 1, 1, 1, 1, 1, 1, 1) + struct.pack("<f", 352)
    header = header.ljust(252, b"\0") + struct.pack("<hh", 0, 1)
    header = header.ljust(280, b"\0") + struct.pack("<12f", 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)
    header = header.ljust(344, b"\0") + b"n+1\0" + bytes(4)

    def label(x, y, z):
        if 1 <= min(x, y, z) and max(x, y, z) <= 4:
            return 1
        return 2 if (x - 8) ** 2 + (y - 8) ** 2 + (z - 8) ** 2 <= 7 else 0

    voxels = range(size)
    return header + bytes(label(x, y, z) for z in voxels for y in voxels for x in voxels)


class Workplace:
    """A folder in which verbs run, one after another."""

    def __init__(self, site, name, inputs_folder, out=None):
        self.site, self.folder, self.inputs = site, site.folder(name), inputs_folder
        (self.folder / "in").symlink_to(inputs_folder)
        self.out = self.folder / "out"
        if out is not None:
            self.out.symlink_to(out)

    def fresh(self, verb):
        """Empties `out`, and makes the files that the verb extends."""
        if self.out.is_symlink():
            for path in self.out.resolve().iterdir():
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        else:
            shutil.rmtree(self.out, ignore_errors=True)
            self.out.mkdir()
        for command in verb.prepare:
            words = command.replace("INPUTS", str(self.inputs)).split()
            ended = run([self.site.program, *words], cwd=self.folder)
            if ended.code != 0:
                raise RuntimeError(f"{verb.name}: {command}: {ended.last()}")
        if verb.name == "study":
            edit_study(self.out / "study.toml", (self.folder / "in").resolve())

    def run(self, verb, again=False, before=(), limit=None, **settings):
        """Runs a verb, optionally as an argument of another command such as strace."""
        limit = limit or HANG + 10 * verb.seconds
        return run([*before, *verb.command(self.site.program, self.inputs, again)], cwd=self.folder, limit=limit, **settings)

    def files(self):
        """Returns all files of `out` by their paths, except locks."""
        root = self.out.resolve()
        return {str(path.relative_to(root)): path for path in sorted(root.rglob("*")) if path.is_file() and path.name != ".lock"}

    def hashes(self):
        return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in self.files().items()}

    def learn(self, verb):
        """Runs a verb twice undisturbed, and records its outputs."""
        runs = []
        for _ in range(2):
            self.fresh(verb)
            ended = self.run(verb, limit=120)
            if ended.code != 0:
                raise RuntimeError(f"{verb.name} fails undisturbed: {ended.last()}")
            runs.append(self.hashes())
            verb.seconds = max(verb.seconds, ended.seconds)
        if runs[0].keys() != runs[1].keys():
            raise RuntimeError(f"{verb.name} writes other files the second time: {runs[0].keys() ^ runs[1].keys()}")
        verb.expected = {
            name: found if runs[1][name] == found and not has_times(name) else None for name, found in runs[0].items()
        }
        verb.bytes_written = sum(path.stat().st_size for path in self.files().values())

    def flaws(self, verb, killed, complete):
        """Yields the flaws of the files after a verb has ended, as `(kind, text)`."""
        for name, path in self.files().items():
            base = name.rsplit("/", 1)[-1]
            if base.startswith(".") and base.endswith(".tmp"):
                if not killed:
                    yield "half", f"{name} is left over"
            elif name not in verb.expected:
                yield "half", f"{name} is no output"
            elif verb.expected[name] is not None and (complete or not verb.goes_on):
                if hashlib.sha256(path.read_bytes()).hexdigest() != verb.expected[name]:
                    yield ("wrong" if complete else "half"), f"{name} has other bytes than undisturbed"
            elif not whole(path):
                yield "half", f"{name} isn't whole"
        if complete:
            for name in verb.expected.keys() - self.files().keys():
                yield "wrong", f"{name} isn't there though the status is 0"

    def judge(self, row, verb, ended, what):
        """Checks how a disturbed run ended, its files, and that a rerun completes everything. Returns whether all
        checks passed."""
        failures = []
        if ended.hung:
            failures.append(("hangs", f"over {HANG} s"))
        elif ended.code >= 101 or b"panicked" in ended.err:
            failures.append(("crashes", f"status {ended.code}: {ended.last()}"))
        elif ended.code not in (0, 1) and not ended.killed:
            failures.append(("wrong", f"status {ended.code}: {ended.last()}"))
        failures += self.flaws(verb, ended.killed, ended.code == 0)
        again = self.run(verb, again=True)
        if again.code != 0:
            failures.append(("wrong", f"the rerun ends with {again.code}: {again.last()}"))
        else:
            failures += [(kind, "after the rerun: " + text) for kind, text in self.flaws(verb, ended.killed, True)]
        for kind, text in failures:
            self.site.find(row, kind, f"{verb.name}, {what}: {text}")
        return not failures


def has_times(name):
    """Returns whether an output contains times, or data in order of time; two runs may give equal files by chance."""
    return name.endswith((".json", ".status.tsv", "_status.tsv")) or "/.study/" in name or "/status/" in name


def whole(path):
    """Returns whether a file whose bytes vary between runs, because it contains times, is complete."""
    data = path.read_bytes()
    if path.name.endswith(".json"):
        try:
            json.loads(data)
        except ValueError:
            return False
        return True
    of_bids = path.parent.name == "logs" and path.name.endswith("_status.tsv")
    if path.name.endswith(".status.tsv") or path.parent.name == "status" or of_bids:
        # Lines are appended to this file: a part of the last line may be missing, and the next run removes that line.
        return True
    if path.name.endswith((".tsv", ".csv")):
        return data.endswith(b"\n")
    if path.name.endswith(".html"):
        return data.rstrip().endswith(b"</html>")
    if path.name.endswith(".npz"):
        try:
            with zipfile.ZipFile(path) as archive:
                return archive.testzip() is None
        except zipfile.BadZipFile:
            return False
    end = {".gii": b"</GIFTI>", ".png": b"IEND\xaeB`\x82", ".gif": b";"}.get(path.suffix)
    return data.rstrip(b"\n").endswith(end) if end else len(data) > 0


def edit_study(path, inputs_folder):
    """Sets the study's table and folder in a file written by `study init`."""
    lines = []
    for line in path.read_text().splitlines():
        key = line.split("=")[0].strip()
        value = {"output": '"results"', "table": f'"{inputs_folder}/study.csv"', "max_degree": "3"}.get(key)
        lines.append(f"{key} = {value}" if value else line)
    path.write_text("\n".join(lines) + "\n")
