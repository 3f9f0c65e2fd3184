//! Finds groups of surfaces whose files state different axes.

use crate::io::landmarks::Frame;

/// Largest number of members that the warning names for LPS, and for RAS.
const NAMED: usize = 8;

/// A warning that the files of a group of surfaces state different axes: some LPS, others RAS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AxesDiffer {
    /// Indices of the members whose files state LPS, counted from 0; at least one.
    pub lps: Vec<usize>,
    /// Indices of the members whose files state RAS, counted from 0; at least one.
    pub ras: Vec<usize>,
}

impl AxesDiffer {
    /// Compares the axes that the members' files state, as returned by [`Meta::axes`](crate::Meta::axes). Returns
    /// `None` unless both LPS and RAS occur. Members whose files don't state their axes are ignored.
    #[must_use]
    pub fn of(stated: &[Option<Frame>]) -> Option<Self> {
        let with = |frame: Frame| (0..stated.len()).filter(|member| stated[*member] == Some(frame)).collect();
        let found = Self { lps: with(Frame::Lps), ras: with(Frame::Ras) };
        (!found.lps.is_empty() && !found.ras.is_empty()).then_some(found)
    }

    /// Returns the text of the warning. `name` returns the name of the member with a given index.
    #[must_use]
    pub fn with_names(&self, name: impl Fn(usize) -> String) -> String {
        let list = |members: &[usize]| {
            let names: Vec<String> = members.iter().take(NAMED).map(|member| name(*member)).collect();
            let more = members.len() - names.len();
            names.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
        };
        format!(
            "the files of the surfaces state different axes: LPS for {}; RAS for {}. LPS and RAS \
             differ by a rotation of 180 degrees, which affects landmarks, given poses, and comparisons of positions; \
             convert all surfaces to the same axes",
            list(&self.lps),
            list(&self.ras)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CoordinateSystem, Meta};

    #[test]
    fn different_axes_are_named_and_unknown_ones_ignored() {
        let stating = |axes: &str| Meta { file_metadata: vec![("SPACE".into(), axes.into())], ..Meta::default() };
        let data_space = "NIFTI_XFORM_SCANNER_ANAT".to_owned();
        let system = CoordinateSystem { transformed_space: data_space.clone(), data_space, matrix: [0.0; 16] };
        let gifti = Meta { coordinate_system: Some(system), ..Meta::default() };
        let metas = [stating("LPS"), Meta::default(), gifti, stating("LPS")];
        let stated: Vec<Option<Frame>> = metas.iter().map(Meta::axes).collect();
        let found = AxesDiffer::of(&stated).expect("a warning");
        assert_eq!(found, AxesDiffer { lps: vec![0, 3], ras: vec![2] });
        let text = found.with_names(|member| format!("s{member}"));
        assert!(text.contains("LPS for s0, s3; RAS for s2."), "{text}");
        assert_eq!(AxesDiffer::of(&stated[..2]), None);
        let many = [vec![Some(Frame::Ras); 10], vec![Some(Frame::Lps)]].concat();
        let text = AxesDiffer::of(&many).map(|found| found.with_names(|member| member.to_string())).unwrap_or_default();
        assert!(text.contains("RAS for 0, 1, 2, 3, 4, 5, 6, 7 and 2 more"), "{text}");
    }
}
