//! Settings and warnings of an alignment.

use std::fmt;

use crate::error::ShapeError;
use crate::pair::Plan;

/// Method by which two surfaces are aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// Searches the rotations of space and of the parameters together.
    #[default]
    Joint,
    /// Rotates both surfaces into the frames of their first-order ellipsoids. The frames are determined only up to half
    /// turns. Therefore each of four rotations of the parameters (three half turns and the identity) is combined with
    /// each of the same four rotations of space, and the best of the 16 pairs is used. Intended for comparison with
    /// other programs.
    FirstOrderEllipsoid,
    /// Rotates only in space and keeps the parameters. Intended for surfaces whose parameters already correspond.
    FixedParameters,
    /// Finds the pose in space from the [surfaces alone](mod@spharm_surface::pose), independently of their maps to the
    /// sphere, and then searches the rotation of the parameters in that pose. Intended for surfaces that were mapped to
    /// the sphere separately: their distance at equal directions, which is the root mean square of |f(u) - g(u)|, may
    /// be smallest in a wrong pose. The distance at equal directions is never below the distance between the surfaces.
    /// If a joint search of both rotations reduces the distance at equal directions below the distance between the
    /// surfaces in the pose found, the result of the joint search is used. Copies of one surface then coincide to
    /// rounding error. Surfaces without area are aligned by [`Method::Joint`].
    Surfaces,
}

/// Settings of an alignment.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignParams {
    /// Method of the alignment; by default [`Method::Joint`].
    pub method: Method,
    /// Highest degree up to which the surfaces are compared; by default the lower of the two surfaces' degrees. The
    /// transform is applied to all degrees of the moving surface.
    pub max_degree: Option<usize>,
    /// Whether the moving surface may be scaled; `false` by default.
    pub scale: bool,
    /// Whether mirror images may be matched; `false` by default.
    pub mirror: bool,
    /// Bandwidth B of the grid of rotations, 2 to 64: the grid has 2B x B x 2B rotations. By default the smaller of 8
    /// and L + 1 for surfaces compared up to degree L, but at least 2.
    pub bandwidth: Option<usize>,
    /// Number of local maxima on the grid of rotations from which the alignment is refined, at least 1; by default 6.
    pub starts: usize,
}

impl Default for AlignParams {
    fn default() -> Self {
        Self { method: Method::Joint, max_degree: None, scale: false, mirror: false, bandwidth: None, starts: 6 }
    }
}

/// Default bandwidth of the grid of rotations.
const BANDWIDTH: usize = 8;

impl AlignParams {
    /// Checks the settings of the search, and returns the plan for surfaces of the degree `degree`.
    pub(crate) fn plan(&self, degree: usize) -> Result<Plan, ShapeError> {
        let refuse =
            |name, found: usize, expected| Err(ShapeError::Setting { name, found: found.to_string(), expected });
        let bandwidth = self.bandwidth.unwrap_or_else(|| BANDWIDTH.min(degree + 1).max(2));
        if !(2..=64).contains(&bandwidth) {
            return refuse("the bandwidth of the grid", bandwidth, "it must be between 2 and 64");
        }
        if self.starts == 0 {
            return refuse("the number of starts", 0, "it must be at least 1");
        }
        Ok(Plan::new(degree, bandwidth, self.starts))
    }
}

/// Warnings about an alignment.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum AlignWarning {
    /// The surfaces have different degrees; the degrees up to `used` were compared.
    DegreesDiffer {
        /// Degree of the moving surface.
        moving: usize,
        /// Degree of the target.
        target: usize,
        /// Highest degree compared.
        used: usize,
    },
    /// A surface is a single point: no rotation was determined.
    Point,
    /// The rotation of space is undetermined about an axis, because one of the surfaces lies on a line or because the
    /// two surfaces are uncorrelated.
    ObjectUndetermined,
    /// The rotations of space and of the parameters can change together without changing the distance, as for a surface
    /// of revolution.
    BothUndetermined,
    /// Both surfaces are planar: a mirror image can't be detected.
    MirrorUndetermined,
    /// The rotation of the parameters is undetermined: in the given pose, rotating the parameters doesn't change the
    /// distance.
    ParametersUndetermined,
    /// The surfaces fit each other nearly as well in another pose.
    PoseInDoubt {
        /// Distance between the surfaces in the pose found.
        distance: f64,
        /// Distance between the surfaces in the other pose.
        second: f64,
    },
    /// The distance between points at equal directions is much larger than the distance between the surfaces, so equal
    /// directions don't correspond.
    PlacesDiffer {
        /// Root mean square distance between the surfaces' points at equal directions.
        rmsd: f64,
        /// Distance between the surfaces in the pose found.
        distance: f64,
    },
    /// The first-order ellipsoid is nearly round, so its frame has little meaning.
    NearlyRound {
        /// The smallest ratio of an axis to the next shorter axis.
        ratio: f64,
    },
}

impl fmt::Display for AlignWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DegreesDiffer { moving, target, used } => {
                write!(f, "the surfaces have degrees {moving} and {target}; degrees up to {used} were compared")
            }
            Self::Point => f.write_str("a surface is a single point, so the rotation is undetermined"),
            Self::ObjectUndetermined => f.write_str(
                "the rotation in space is undetermined about one axis: a surface lies on a line, or the surfaces are \
                 uncorrelated",
            ),
            Self::BothUndetermined => f.write_str(
                "the rotations in space and of the parameters are undetermined: rotating both together doesn't change \
                 the distance, as for a surface of revolution",
            ),
            Self::ParametersUndetermined => f.write_str(
                "the rotation of the parameters is undetermined: in the given pose, rotating the parameters doesn't \
                 change the distance",
            ),
            Self::PoseInDoubt { distance, second } => write!(
                f,
                "the pose is doubtful: the distance between the surfaces is {distance:.4}, but another pose has a \
                 similar distance of {second:.4}"
            ),
            Self::PlacesDiffer { rmsd, distance } => write!(
                f,
                "the distance between points at equal directions is {rmsd:.4}, but between the surfaces it is \
                 {distance:.4}: equal directions don't correspond"
            ),
            Self::MirrorUndetermined => f.write_str("the surfaces are planar: a mirror image can't be detected"),
            Self::NearlyRound { ratio } => write!(
                f,
                "two axes of the first-order ellipsoid have nearly equal lengths, with a ratio of {ratio:.3}: the \
                 orientation of the ellipsoid is unreliable"
            ),
        }
    }
}
