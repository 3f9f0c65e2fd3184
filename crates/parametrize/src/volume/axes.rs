//! Represents the order of an array's axes, and its name in arguments and provenance.

use crate::error::ParametrizeError;

/// The order of the axes of a NumPy array in a file. Other formats have a fixed order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AxisOrder {
    /// The first axis is x, the last axis z.
    #[default]
    Xyz,
    /// The first axis is z, the last axis x, as in images of scikit-image, tifffile and napari.
    Zyx,
}

impl AxisOrder {
    /// Returns the order that a name, as used in arguments and provenance, denotes.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::Argument`] if the name is neither `xyz` nor `zyx`.
    pub fn named(name: &str) -> Result<Self, ParametrizeError> {
        match name {
            "xyz" => Ok(Self::Xyz),
            "zyx" => Ok(Self::Zyx),
            other => {
                let (what, expected) = ("axes", "xyz or zyx");
                Err(ParametrizeError::Argument { what, expected, found: other.to_owned() })
            }
        }
    }

    /// Returns the name used in arguments and provenance.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Xyz => "xyz",
            Self::Zyx => "zyx",
        }
    }
}
