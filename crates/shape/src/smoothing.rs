//! Checks whether the models of a group were smoothed equally.
//!
//! Smoothing reduces noise and detail. If only some models are smoothed, or models are smoothed by different amounts,
//! tests and modes also show the effect of the smoothing.

use std::fmt;

use serde_json::{Map, Value, json};
use spharm_model::{Provenance, Settings};
use spharm_monitor::number;

use crate::heat::HeatKernel;

/// Name of the provenance field that stores the penalty of a fit if the settings of the fit are omitted.
const PENALTY: &str = "fit_penalty";
/// Diffusion times are treated as equal if their relative difference is at most this value, because each time is a sum
/// with rounding errors.
const ROUNDING: f64 = 1e-9;
/// Maximum number of kinds of smoothing that a message lists.
const LISTED: usize = 5;

/// Smoothness penalty with which a model was fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Penalty {
    /// No penalty, the default penalty, or an unknown penalty of a model without a record of its fit.
    Default,
    /// A given smoothness penalty, lambda.
    Fixed(f64),
    /// A smoothness penalty chosen by cross-validation.
    Auto,
    /// A smoothness penalty chosen so that it removes noise.
    Denoise,
}

/// Smoothing of a model, as recorded in its provenance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothing {
    /// The penalty of the fit.
    pub penalty: Penalty,
    /// Sum of the diffusion times of the heat kernels that were applied to the model; 0 for none.
    pub time: f64,
}

/// Models of a group that were smoothed equally.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothedAlike {
    /// The smoothing of these models.
    pub smoothing: Smoothing,
    /// Number of models with this smoothing.
    pub count: usize,
    /// Index of the first model with this smoothing, counted from 0.
    pub first: usize,
}

/// Warning that the models of a group were smoothed differently.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothingDiffers {
    /// The kinds of smoothing, in the order of their first models; at least two.
    pub kinds: Vec<SmoothedAlike>,
}

impl Penalty {
    fn of_settings(settings: &Settings) -> Self {
        Self::of(settings.smoothness_choice.as_deref(), settings.smoothness)
    }

    /// Returns the penalty with the given name and weight lambda. Models written by version 0.1 don't name the penalty.
    fn of(name: Option<&str>, lambda: f64) -> Self {
        match name {
            Some("denoise") => Self::Denoise,
            Some("auto") => Self::Auto,
            Some("fixed") | None if lambda > 0.0 => Self::Fixed(lambda),
            _ => Self::Default,
        }
    }
}

impl Smoothing {
    /// Returns the smoothing that is recorded in a model's provenance.
    #[must_use]
    pub fn of(provenance: &Provenance) -> Self {
        let kept = |kept: &Value| Penalty::of(kept["choice"].as_str(), kept["lambda"].as_f64().unwrap_or(0.0));
        let of_kept = || provenance.other.get(PENALTY).map_or(Penalty::Default, kept);
        let steps = provenance.other.get("transform").and_then(Value::as_array);
        let times = steps.into_iter().flatten().filter_map(|step| step["heat_kernel"]["s"].as_f64());
        Self { penalty: provenance.settings.as_ref().map_or_else(of_kept, Penalty::of_settings), time: times.sum() }
    }

    fn equals(&self, other: &Self) -> bool {
        let most = self.time.abs().max(other.time.abs());
        self.penalty == other.penalty && (self.time - other.time).abs() <= ROUNDING * most
    }
}

impl fmt::Display for Smoothing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let penalty = match self.penalty {
            Penalty::Default => None,
            Penalty::Fixed(lambda) => Some(format!("fitted with the smoothness penalty {}", number(lambda))),
            Penalty::Auto => Some("fitted with a smoothness penalty chosen by cross-validation".to_owned()),
            Penalty::Denoise => Some("denoised".to_owned()),
        };
        let kernel = HeatKernel::after(self.time).ok().filter(|_| self.time > 0.0).map(|kernel| {
            format!("smoothed by a heat kernel with an FWHM of {} degrees", number(kernel.width().to_degrees()))
        });
        match (penalty, kernel) {
            (None, None) => f.write_str("not smoothed"),
            (Some(one), None) | (None, Some(one)) => f.write_str(&one),
            (Some(penalty), Some(kernel)) => write!(f, "{penalty} and {kernel}"),
        }
    }
}

impl SmoothingDiffers {
    /// Compares the smoothing of a group's models. Returns `None` if all models were smoothed equally.
    #[must_use]
    pub fn of(models: &[Smoothing]) -> Option<Self> {
        let mut kinds: Vec<SmoothedAlike> = Vec::new();
        for (first, smoothing) in models.iter().enumerate() {
            match kinds.iter_mut().find(|kind| kind.smoothing.equals(smoothing)) {
                Some(kind) => kind.count += 1,
                None => kinds.push(SmoothedAlike { smoothing: *smoothing, count: 1, first }),
            }
        }
        (kinds.len() > 1).then_some(Self { kinds })
    }

    /// Returns the warning's message. `name` returns the name of the model with a given index.
    #[must_use]
    pub fn with_names(&self, name: impl Fn(usize) -> String) -> String {
        let of = |kind: &SmoothedAlike| format!("{} {} (first: {})", kind.count, kind.smoothing, name(kind.first));
        let mut listed: Vec<String> = self.kinds.iter().take(LISTED).map(of).collect();
        let more: usize = self.kinds.iter().skip(LISTED).map(|kind| kind.count).sum();
        if more > 0 {
            listed.push(format!("{more} in other ways"));
        }
        format!(
            "the models were smoothed differently: {}; effects may be caused by the smoothing: fit and smooth all \
             models with the same settings",
            listed.join(", ")
        )
    }
}

impl fmt::Display for SmoothingDiffers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.with_names(|index| format!("model {index}")))
    }
}

/// Adds the penalty of a fit to `kept`, the other fields of a provenance. Intended for models whose coefficients
/// change: their provenance omits the `settings` of the fit, but should keep the penalty. The default penalty isn't
/// added.
pub fn keep_penalty(settings: Option<&Settings>, kept: &mut Map<String, Value>) {
    if let Some(settings) = settings.filter(|settings| Penalty::of_settings(settings) != Penalty::Default) {
        let (choice, lambda) = (&settings.smoothness_choice, settings.smoothness);
        kept.insert(PENALTY.to_owned(), json!({ "choice": choice, "lambda": lambda }));
    }
}

#[cfg(test)]
mod tests {
    use spharm_model::Model;
    use spharm_monitor::Silent;
    use spharm_surface::Kind;

    use super::*;
    use crate::codec::{CompressParams, ExpandParams, Target, compress, expand};
    use crate::samples::{blob, some_pose};

    fn provenance(json: &Value) -> Provenance {
        Provenance::parse(&json.to_string())
    }

    fn fitted(choice: &str, lambda: f64) -> Provenance {
        let found = provenance(&json!({
            "method": "lsq", "passes": 1, "granularity": null, "start_degree": null, "weights": "area",
            "smoothness_choice": choice, "smoothness": lambda, "dtype": "f64",
        }));
        assert!(found.settings.is_some());
        found
    }

    #[test]
    fn models_smoothed_differently_are_counted_by_kind() {
        let heat = |time: f64| provenance(&json!({ "transform": [{ "heat_kernel": { "s": time } }] }));
        let twice = json!({ "transform": [{ "heat_kernel": { "s": 0.01 } }, { "heat_kernel": { "s": 0.02 } }] });
        let models = [
            fitted("default", 1e-9),
            heat(0.03),
            provenance(&twice),
            fitted("denoise", 0.0),
            fitted("fixed", 0.5),
            fitted("fixed", 0.0),
            fitted("auto", 0.1),
            fitted("auto", 0.2),
            Provenance::default(),
        ];
        let smoothing = models.each_ref().map(Smoothing::of);
        let found = SmoothingDiffers::of(&smoothing).unwrap();
        let counts: Vec<(usize, usize)> = found.kinds.iter().map(|kind| (kind.count, kind.first)).collect();
        assert_eq!(counts, [(3, 0), (2, 1), (1, 3), (1, 4), (2, 6)]);
        let text = found.to_string();
        assert!(
            text.contains("3 not smoothed (first: model 0), 2 smoothed by a heat kernel with an FWHM of 33."),
            "{text}"
        );
        assert!(text.contains("1 denoised (first: model 3), 1 fitted with the smoothness penalty 0.5"), "{text}");
        assert_eq!(SmoothingDiffers::of(&smoothing[1..3]), None);
        assert_eq!(SmoothingDiffers::of(&[]), None);
    }

    #[test]
    fn the_penalty_is_known_after_a_motion_and_a_compression() {
        let mut model = Model::without_sphere(blob(3, 1), Kind::Surface);
        model.provenance = fitted("denoise", 0.0);
        let moved = some_pose(1).apply_model(&model, &Silent).unwrap();
        assert!(moved.provenance.settings.is_none());
        assert_eq!(Smoothing::of(&moved.provenance), Smoothing { penalty: Penalty::Denoise, time: 0.0 });
        let again = some_pose(2).apply_model(&moved, &Silent).unwrap();
        assert_eq!(Smoothing::of(&again.provenance).penalty, Penalty::Denoise);
        for before in [&model, &moved] {
            let file = compress(before, &CompressParams::new(Target::Step(1e-4)), &Silent).unwrap();
            let expanded = expand(&file.bytes, &ExpandParams::default()).unwrap().model.provenance;
            assert!(expanded.settings.is_none());
            assert_eq!(Smoothing::of(&expanded), Smoothing { penalty: Penalty::Denoise, time: 0.0 });
        }
        model.provenance = fitted("default", 1e-9);
        let moved = some_pose(1).apply_model(&model, &Silent).unwrap();
        assert!(!moved.provenance.other.contains_key(PENALTY));
    }
}
