//! Defines the measures by which subjects are compared.

use spharm::shape::outliers::FAR;

/// A measure by which subjects are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Volume enclosed by the model.
    Volume,
    /// Area of the model.
    Area,
    /// Sphericity of the model.
    Sphericity,
    /// Root mean square distance between the model's surface and the input's.
    Rms,
    /// Root mean square distance between the aligned model and the mean of the group.
    Distance,
}

impl Measure {
    /// All measures, in the order of their values in arrays.
    pub const ALL: [Self; 5] = [Self::Volume, Self::Area, Self::Sphericity, Self::Rms, Self::Distance];

    /// Returns the name of the measure.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Volume => "volume",
            Self::Area => "area",
            Self::Sphericity => "sphericity",
            Self::Rms => "rms",
            Self::Distance => "distance from the mean",
        }
    }

    /// Returns the measure with the given key in reports of `shape check`, or `None` for an unknown key.
    #[must_use]
    pub fn with_key(key: &str) -> Option<Self> {
        let keys = ["volume", "area", "sphericity", "rms", "distance"];
        keys.into_iter().zip(Self::ALL).find(|(known, _)| *known == key).map(|(_, measure)| measure)
    }

    /// Returns whether a value with robust z `z` is flagged. Unusually small residuals and distances aren't flagged.
    #[must_use]
    pub fn is_far(self, z: f64) -> bool {
        z > FAR || (z < -FAR && !matches!(self, Self::Rms | Self::Distance))
    }
}
