//! Writes the summary, which compares the measurements with the paper's results.

use crate::experiments::{Pass, Results};
use crate::extent::{Extent, Settings};
use crate::published::{NLSF_DEGREE, PUBLISHED, Quality};
use crate::surfaces::Surface;
use crate::tables::markdown;

/// Peak memory and duration of the run that made the measurements.
#[derive(Debug, Clone, Copy)]
pub struct Circumstances {
    /// Peak resident memory of the process in bytes; `None` if the system doesn't report it.
    pub peak: Option<u64>,
    /// Duration of the entire run in seconds.
    pub seconds: f64,
}

/// Returns the summary as Markdown text.
pub(crate) fn summary(
    results: &Results,
    extent: &Extent,
    surfaces: &[Surface],
    settings: &Settings,
    circumstances: &Circumstances,
) -> String {
    let sections = [
        opening(settings, circumstances),
        beside_the_paper(results, surfaces, settings.quick),
        figure5(results),
        figures6_7(results, extent),
        between(results),
        families(results),
        table1(results),
        figure3(results),
    ];
    sections.join("\n")
}

fn strings<const N: usize>(cells: [&str; N]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

fn short(value: f64) -> String {
    format!("{value:.2e}")
}

fn size(bytes: u64) -> String {
    match bytes {
        0..1_048_576 => format!("{:.1} KiB", bytes as f64 / 1_024.0),
        1_048_576..1_073_741_824 => format!("{:.1} MiB", bytes as f64 / 1_048_576.0),
        _ => format!("{:.2} GiB", bytes as f64 / 1_073_741_824.0),
    }
}

/// Formats a number of seconds with about three significant digits.
fn seconds(value: f64) -> String {
    let decimals = [1.0, 10.0, 100.0].into_iter().position(|bound| value < bound).map_or(0, |at| 3 - at);
    format!("{value:.decimals$}")
}

fn off(found: Quality, reference: Option<Quality>) -> String {
    reference.map_or("-".to_owned(), |reference| format!("{:.0e}", found.off(reference)))
}

fn opening(settings: &Settings, circumstances: &Circumstances) -> String {
    let Settings { quick, threads, memory, .. } = settings;
    let Circumstances { peak, seconds } = circumstances;
    let version = env!("CARGO_PKG_VERSION");
    let peak = peak.map_or(String::new(), |peak| format!(", {} at the peak", size(peak)));
    let caution = if *quick {
        "\nThis is a quick run with a small surface and low degrees, which only shows that everything works. Its times \
         and errors can't be compared with the paper's.\n"
    } else {
        ""
    };
    format!(
        "# The paper's experiments\n\nAfter L. Shen and M. K. Chung, \"Large-scale modeling of parametric surfaces \
         using spherical harmonics\", 3DPVT 2006. spharm {version}, {threads} threads, {} of memory allowed{peak}, \
         {seconds:.0} s in total.\n{caution}\nmsd and xsd are the mean and the maximum of the squared distances, with \
         the bounding box scaled to volume 1. The seconds of a fit are the time of its sweeps, which read the basis \
         from the store (or from the system's cache); figure 3 shows the time for building the basis, from the start \
         to the files on disk.\n",
        size(*memory as u64),
    )
}

fn beside_the_paper(results: &Results, surfaces: &[Surface], quick: bool) -> String {
    let mut rows = vec![strings([
        "surface",
        "n",
        "p",
        "g",
        "s",
        "paper, s",
        "ratio",
        "msd",
        "paper, msd",
        "xsd",
        "paper, xsd",
        "reference",
    ])];
    for surface in surfaces {
        let published = PUBLISHED.iter().filter(|published| published.kind == surface.kind);
        for published in published {
            let of = |pass: &&Pass| pass.surface == surface.name && pass.is(published.passes, published.granularity);
            let Some(pass) = results.grid.iter().find(of) else { continue };
            let quality = pass.measured.quality;
            rows.push(vec![
                surface.name.clone(),
                pass.vertices.to_string(),
                published.passes.to_string(),
                published.granularity.to_string(),
                seconds(pass.measured.seconds),
                format!("{}", published.seconds),
                // Quick experiments are smaller than the paper's, so the ratio of times would be meaningless.
                if quick { "-".to_owned() } else { format!("{:.0}", published.seconds / pass.measured.seconds) },
                short(quality.msd),
                short(published.msd),
                short(quality.xsd),
                short(published.xsd),
                off(quality, pass.reference),
            ]);
        }
    }
    let theirs: Vec<String> = PUBLISHED.iter().map(|p| format!("a {} of {} vertices", p.name, p.vertices)).collect();
    let mut text = format!(
        "## Comparison with the paper\n\nThe paper measured {}, on a computer from 2006. Only head27618 is the paper's \
         own surface, but over another sphere; the other surfaces are of the same kind and size, so times can be \
         compared, but errors only by order of magnitude. The ratio is the paper's seconds divided by ours. The last \
         column is the relative difference of msd or xsd from reference.json, whichever is larger.\n\n{}",
        theirs.join(", "),
        markdown(&rows)
    );
    for surface in surfaces {
        let pass = results.grid.iter().find(|pass| pass.surface == surface.name);
        if let Some(pass) = pass.filter(|pass| pass.columns() > pass.vertices) {
            text += &format!(
                "\n{} has fewer vertices ({}) than basis functions ({}): its least-squares solution is not unique, and \
                 the passes approach one of many solutions.\n",
                surface.name,
                pass.vertices,
                pass.columns()
            );
        }
    }
    text
}

fn figure5(results: &Results) -> String {
    let mut rows = vec![strings(["surface", "L", "msd", "xsd", "s", "reference"])];
    rows.extend(results.sirf.iter().map(|row| {
        let quality = row.measured.quality;
        vec![
            row.surface.clone(),
            row.max_degree.to_string(),
            short(quality.msd),
            short(quality.xsd),
            seconds(row.measured.seconds),
            off(quality, row.reference),
        ]
    }));
    format!("## Figure 5: SIRF, one degree per block and one pass\n\n{}", markdown(&rows))
}

fn figures6_7(results: &Results, extent: &Extent) -> String {
    let passes: Vec<usize> = [1, 2, 4, 8].into_iter().filter(|&p| p <= extent.passes).collect();
    let mut header = strings(["surface", "g"]);
    header.extend(passes.iter().map(|p| format!("msd, p = {p}")));
    header.extend(passes.iter().map(|p| format!("s, p = {p}")));
    let mut rows = vec![header];
    for first in results.grid.iter().filter(|pass| pass.pass == 1) {
        let of_fit: Vec<&Pass> = results
            .grid
            .iter()
            .filter(|pass| pass.surface == first.surface && pass.granularity == first.granularity)
            .collect();
        let at = |p: usize| of_fit.iter().find(|pass| pass.pass == p);
        let mut row = vec![first.surface.clone(), first.granularity.to_string()];
        row.extend(passes.iter().map(|&p| at(p).map_or(String::new(), |pass| short(pass.measured.quality.msd))));
        row.extend(passes.iter().map(|&p| at(p).map_or(String::new(), |pass| seconds(pass.measured.seconds))));
        rows.push(row);
    }
    let worst = results.grid.iter().filter_map(|pass| Some(pass.measured.quality.off(pass.reference?)));
    let worst = worst
        .reduce(f64::max)
        .map_or(String::new(), |worst| format!(" The largest relative difference from reference.json is {worst:.0e}."));
    format!(
        "## Figures 6 and 7: IRF to degree {} over passes p and granularity g\n\n\
         Each row is one fit of {} passes, measured after every pass: the state after p passes is the result of a fit \
         with p passes. The first pass factorises the blocks, and later passes reuse the factorisations.{worst}\n\n{}",
        extent.max_degree,
        extent.passes,
        markdown(&rows)
    )
}

fn between(results: &Results) -> String {
    let mut rows =
        vec![strings(["surface", "L", "p", "g", "mean", "rms", "95 %", "Hausdorff", "Hausdorff, own unit", "bound"])];
    rows.extend(results.between.iter().map(|row| {
        let d = &row.distance;
        let counts = [row.max_degree, row.pass, row.granularity].map(|count| count.to_string());
        let mut cells: Vec<String> = std::iter::once(row.surface.clone()).chain(counts).collect();
        cells.extend([d.mean, d.rms, d.percentile95, d.hausdorff].map(|x| short(x / d.scale)));
        cells.extend([short(d.hausdorff), short(d.bound / d.scale)]);
        cells
    }));
    format!(
        "## Between the vertices\n\nDistances (not squared) between the surface and the reconstruction of the last fit \
         at four times as many vertices, measured from points spread over both surfaces, with the bounding box scaled \
         to volume 1. The surface consists of flat triangles, over which a smooth reconstruction bulges. The true \
         Hausdorff distance exceeds the measured distance by at most the bound.\n\n{}",
        markdown(&rows)
    )
}

fn families(results: &Results) -> String {
    let mut rows = vec![strings(["surface", "n", "L", "least squares msd", "xsd", "s", "quadrature msd", "xsd", "s"])];
    rows.extend(results.families.iter().map(|row| {
        let [a, b] = [row.least_squares, row.quadrature];
        let mark = if row.converged { "" } else { " (*)" };
        vec![
            row.surface.clone(),
            row.vertices.to_string(),
            row.max_degree.to_string(),
            format!("{}{mark}", short(a.quality.msd)),
            short(a.quality.xsd),
            seconds(a.seconds),
            short(b.quality.msd),
            short(b.quality.xsd),
            seconds(b.seconds),
        ]
    }));
    format!(
        "## Least squares and quadrature\n\nThe paper leaves this comparison as future work. The least-squares fits \
         minimise the squared distances at the vertices, without a matrix in memory. For the quadrature, the surface \
         is resampled over the sphere's triangles to a Gauss-Legendre grid of L + 1 rings, on which the quadrature is \
         exact. msd and xsd are measured at the vertices; (*) marks a least-squares fit that didn't reach the tolerance \
         with this sampling.\n\n{}",
        markdown(&rows)
    )
}

fn table1(results: &Results) -> String {
    let mut rows = vec![strings(["memory", "largest L", "planned", "L fitted", "msd", "xsd", "s"])];
    let none = || "-".to_owned();
    rows.extend(results.nlsf.iter().map(|row| {
        let measured = row.fitted.map(|(_, measured)| measured);
        vec![
            size(row.memory as u64),
            row.max_degree.map_or_else(none, |l| if row.capped { format!("{l} or more") } else { l.to_string() }),
            row.planned.map_or_else(none, |bytes| size(bytes as u64)),
            row.fitted.map_or_else(none, |(degree, _)| degree.to_string()),
            measured.map_or_else(none, |m| short(m.quality.msd)),
            measured.map_or_else(none, |m| short(m.quality.xsd)),
            measured.map_or_else(none, |m| seconds(m.seconds)),
        ]
    }));
    let vertices = results.nlsf.first().map_or(0, |row| row.vertices);
    format!(
        "## Table 1: NLSF, the full least squares, in bounded memory\n\nFor each memory limit, the largest degree \
         whose planned memory is within the limit, at {vertices} vertices. In 2006 the paper reached about degree \
         {NLSF_DEGREE} at 40962 vertices.\n\n{}",
        markdown(&rows)
    )
}

fn figure3(results: &Results) -> String {
    let mut rows = vec![strings(["along", "n", "L", "s", "size"])];
    rows.extend(results.basis.iter().map(|row| {
        vec![
            row.along.to_owned(),
            row.vertices.to_string(),
            row.max_degree.to_string(),
            seconds(row.seconds),
            size(row.bytes),
        ]
    }));
    format!("## Figure 3: building the basis\n\n{}", markdown(&rows))
}
