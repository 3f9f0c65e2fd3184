"""Writes the output of `validation.py`: tables between the markers of a page, and pictures.

A table lies between `<!-- table: NAME -->` and `<!-- end -->`; a generated line lies between `<!-- line: NAME -->` and
`<!-- end -->`. The rest of the page is written by hand and isn't changed.
"""

import datetime
import io
import os
import platform
import re
import shutil
import sys
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
import spharm_rs as sp
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "validation.md"
sys.path.insert(0, str(ROOT / "examples" / "python"))
COLOURS = {"plain": "#b08968", "registered": "#7aa6c2", "correspond": "#1f5a87", "truth": "#4a4a4a"}


def processor():
    try:
        model = re.search(r"^model name\s*: (.*)", Path("/proc/cpuinfo").read_text(), re.M)
        return model[1] if model else platform.processor()
    except OSError:
        return platform.processor() or platform.machine()


class Page:
    """The page docs/validation.md or, with `quick`, a copy of it in target/validation."""

    def __init__(self, quick):
        self.path, self.pictures = PAGE, PAGE.parent / "figures" / "validation"
        if quick:
            self.path = ROOT / "target" / "validation" / PAGE.name
            self.pictures = self.path.parent / "figures" / "validation"
            self.path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(PAGE, self.path)
        self.pictures.mkdir(parents=True, exist_ok=True)

    def put(self, kind, name, text):
        page = self.path.read_text(encoding="utf-8")
        pattern = re.compile(rf"(<!-- {kind}: {name} -->\n).*?(<!-- end -->)", re.S)
        if not pattern.search(page):
            raise SystemExit(f"{self.path}: there is no <!-- {kind}: {name} -->")
        self.path.write_text(pattern.sub(lambda found: f"{found[1]}{text}\n{found[2]}", page, count=1), encoding="utf-8")
        print(f"\n{name}\n{text}", flush=True)

    def table(self, name, head, rows):
        """Writes a table of texts and numbers; a column after the first is right-aligned if it holds a number."""
        texts = [[cell if isinstance(cell, str) else f"{cell:g}" for cell in row] for row in rows]
        right = [any(not isinstance(row[k], str) or re.match(r"-?\d", row[k]) for row in rows) for k in range(len(head))]
        ruler = ["--:" if column and k else "---" for k, column in enumerate(right)]
        self.put("table", name, "\n".join("| " + " | ".join(row) + " |" for row in [head, ruler, *texts]))

    def measured(self, name):
        """Writes the line that states where and when a part was measured."""
        today = datetime.date.today()
        self.put("line", name, f"Measured on {today.day} {today:%B %Y} with spharm-rs {sp.__version__} on {os.cpu_count()} cores "
                               f"of {processor()}.")

    def picture(self, name, figure):
        path = self.pictures / f"{name}.png"
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=100, facecolor="white")
        plt.close(figure)
        # A palette of 256 colours halves the file's size.
        Image.open(drawn).convert("RGB").quantize(256).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB", flush=True)


def bars(groups, series, label, limits=None):
    """Draws bars of each series, {name: (colour, values)}, side by side at the groups' names."""
    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    width = 0.8 / len(series)
    for k, (name, (colour, values)) in enumerate(series.items()):
        at = np.arange(len(groups)) + (k - (len(series) - 1) / 2) * width
        axes.bar(at, [value or 0 for value in values], width * 0.94, color=colour, label=name)
        for x in at[[value is None for value in values]]:
            axes.text(x, 0.01, "–", ha="center", transform=axes.get_xaxis_transform())
    axes.set_xticks(range(len(groups)), groups)
    axes.set(ylabel=label, ylim=limits)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    return figure


def scores(panels):
    """Draws the truth against the first score, in one panel for each (title, truth, {name: (colour, score)})."""
    figure, axes = plt.subplots(1, len(panels), figsize=(3.2 * len(panels), 3), layout="constrained")
    for panel, (title, truth, series) in zip(np.atleast_1d(axes), panels):
        for name, (colour, score) in series.items():
            score = score * np.sign(np.corrcoef(score, truth)[0, 1]) / np.std(score)
            panel.plot(truth, score, "o", ms=4, color=colour, label=name)
        panel.set(title=title, xlabel="truth")
        panel.spines[["top", "right"]].set_visible(False)
    first = np.atleast_1d(axes)[0]
    first.set_ylabel("score of the first mode, sd")
    first.legend(frameon=False, fontsize=8)
    return figure


def curves(panels):
    """Draws lines over the number of modes, in one panel for each (title, {name: (colour, values)})."""
    figure, axes = plt.subplots(1, len(panels), figsize=(3.4 * len(panels), 2.8), layout="constrained")
    for panel, (title, series) in zip(axes, panels):
        for name, (colour, values) in series.items():
            panel.plot(np.arange(1, len(values) + 1), values, "o-", ms=3, color=colour, label=name)
        panel.set(title=title, xlabel="modes", ylim=(0, None), xticks=range(1, 1 + len(values), 1 + len(values) // 6))
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("mm")
    axes[-1].legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def maps(rows):
    """Draws surfaces coloured by -log10 p in a row of panels, one for each (title, surface, p)."""
    from draw import panels

    values = [-np.log10(p) for _, _, p in rows]
    return panels([surface for _, surface, _ in rows], values, [title for title, _, _ in rows], columns=3,
                  limits=(0, 3), label="-log10 family-wise p", view=(50, 25))
