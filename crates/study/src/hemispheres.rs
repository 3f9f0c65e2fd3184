//! Warns about fits with a sphere or mask of the other hemisphere. A fit gives the same warning, but only while it
//! runs.

use std::collections::HashSet;

use anyhow::Result;
use rayon::prelude::*;
use spharm::Model;
use spharm_cli::output::{counted, first_of};
use spharm_cohort::Row;
use spharm_model::recorded_name;

use super::plan::{Plan, Subject};

/// Maximum number of fits that the warning names.
const NAMED: usize = 6;

/// Returns a warning if the models of the given subjects record a sphere or mask of the other hemisphere.
pub(super) fn differ(plan: &Plan, subjects: &[Subject<'_>]) -> Result<Option<String>> {
    let ids: HashSet<&str> = subjects.iter().map(|subject| subject.id).collect();
    let mut found = Vec::new();
    for fits in plan.fits() {
        // A surface without a sphere is mapped to a sphere of its own.
        let on_sphere = fits.manifest.rows.iter().filter(|row| row.sphere.is_some() || plan.has_one_sphere());
        let rows: Vec<&Row> = on_sphere.filter(|row| ids.contains(row.id.as_str())).collect();
        // The mask isn't passed to fits of signals, so it is checked only for fits of surfaces.
        let mask = plan.study.fit.value("--mask").filter(|_| fits.is_of_surfaces());
        let of_row = |row: &&Row| -> Result<Option<String>> {
            let made = Model::read_provenance(fits.model(&row.id))?;
            Ok(made.file_of_other_hemisphere(mask).map(|file| format!("{} ({})", row.id, recorded_name(file))))
        };
        found.extend(rows.par_iter().map(of_row).collect::<Result<Vec<_>>>()?.into_iter().flatten());
    }
    Ok((!found.is_empty()).then(|| {
        format!(
            "{} {} a sphere or mask of the other hemisphere: {}; give files of the same hemisphere as the surfaces",
            counted(found.len(), "fit"),
            if found.len() == 1 { "has" } else { "have" },
            first_of(found.iter().map(String::as_str), NAMED)
        )
    }))
}
