//! Determines the hemisphere of a model, and the anatomical structure of its surface.

use std::path::Path;

use serde_json::Value;
use spharm_surface::{Hemisphere, Kind, Similarity};

use crate::file_record::recorded_name;
use crate::model::Model;
use crate::provenance::Provenance;

impl Model {
    /// Returns the hemisphere of the brain to which the model belongs. The hemisphere is taken from the metadata of the
    /// input. If the metadata don't state the hemisphere, a file name determines it: the name of the input, of the
    /// sphere or of the model (`path`), in this order. A model that was mirrored after the fit belongs to the
    /// hemisphere opposite to that of its files.
    #[must_use]
    pub fn hemisphere(&self, path: Option<&Path>) -> Option<Hemisphere> {
        let made = &self.provenance;
        let input = made.input.as_ref().map(|input| Path::new(&input.path));
        let sphere = made.sphere.as_deref().map(Path::new);
        let named = || [input, sphere, path].into_iter().flatten().find_map(named);
        // Mirroring a model changes its metadata, but not the names of its files. Therefore only a hemisphere from a
        // file name is replaced by its opposite.
        Hemisphere::of(made.anatomical_structure_primary.as_deref(), None).or_else(|| named().map(|of| self.now(of)))
    }

    /// Returns the anatomical structure as a value of GIfTI's `AnatomicalStructurePrimary`. The value is copied from
    /// the input if the input states it. Otherwise, if the model was fitted over a given sphere of a hemisphere, such
    /// as `lh.sphere.reg`, the value is the hemisphere's cortex. The name of a sphere that was computed for the model,
    /// such as `s1_lh.sphere.surf.gii`, isn't used, because the surface may be any body.
    #[must_use]
    pub fn anatomical_structure(&self) -> Option<String> {
        let cortex = || {
            let given = self.provenance.sphere.as_deref().filter(|_| !self.provenance.parametrized);
            let sphere = named(Path::new(given?))?;
            Some(self.hemisphere(None).unwrap_or(sphere).cortex().to_owned())
        };
        self.provenance.anatomical_structure_primary.clone().or_else(cortex)
    }

    /// Returns the hemisphere of the model after any mirroring, given the hemisphere of the files from which the model
    /// was made.
    fn now(&self, of_files: Hemisphere) -> Hemisphere {
        if self.provenance.is_mirrored(self.kind()) { of_files.opposite() } else { of_files }
    }
}

impl Provenance {
    /// Returns the path of the fit's sphere or mask if the file's name states a different hemisphere from the one
    /// stated by the input's metadata or name. If neither states the input's hemisphere, the name of the sphere
    /// determines it. `mask` is the mask of the whole run, which the provenance doesn't record. Returns `None` if all
    /// files belong to one hemisphere, or if the hemispheres are unknown.
    #[must_use]
    pub fn file_of_other_hemisphere<'a>(&'a self, mask: Option<&'a str>) -> Option<&'a str> {
        // Every fit records whether its input is a surface.
        let kind = if self.surface.unwrap_or(true) { Kind::Surface } else { Kind::Signal };
        let mirrored = self.is_mirrored(kind);
        let of = |path: &str| named(Path::new(path)).map(|of| if mirrored { of.opposite() } else { of });
        let sphere = self.sphere.as_deref().filter(|_| !self.parametrized);
        let region = self.region.as_ref().map(|region| region.path.as_str());
        let own = Hemisphere::of(self.anatomical_structure_primary.as_deref(), None)
            .or_else(|| self.input.as_ref().and_then(|input| of(&input.path)))
            .or_else(|| sphere.and_then(&of))?;
        [sphere, mask, region].into_iter().flatten().find(|path| of(path).is_some_and(|of| of != own))
    }

    /// Returns whether the model is a mirror image, according to its recorded transforms: the transforms applied to the
    /// model, and the similarity from the surface to the frame of a group.
    fn is_mirrored(&self, kind: Kind) -> bool {
        let mirrors = |matrix: &Value| {
            let matrix = serde_json::from_value::<[[f64; 3]; 3]>(matrix.clone());
            matrix.is_ok_and(|orthogonal| Similarity { orthogonal, ..Similarity::default() }.mirrors())
        };
        let is_surface = kind == Kind::Surface;
        // A signal isn't moved in space; only its sphere is mirrored.
        let step = |step: &&Value| {
            if is_surface { mirrors(&step["object"]) } else { step["antipodal"].as_bool() == Some(true) }
        };
        let recorded = |name: &str| self.other.get(name);
        let steps = recorded("transform").and_then(Value::as_array).into_iter().flatten().filter(step).count();
        let to_group = recorded("to_group").is_some_and(|to_group| mirrors(&to_group["orthogonal"]));
        (steps % 2 == 1) != to_group
    }
}

/// Returns the hemisphere that the name of a file states. The path may have been recorded on another operating system.
fn named(path: &Path) -> Option<Hemisphere> {
    let name = path.to_str().map(recorded_name);
    Hemisphere::of(None, name.map(Path::new))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file_record::FileRecord;
    use serde_json::json;
    use spharm_harmonics::Coefficients;

    fn model(kind: Kind, input: Option<&str>) -> Model {
        let mut model = Model::without_sphere(Coefficients::new(ndarray::Array2::ones((4, 3))).unwrap(), kind);
        model.provenance.input = input.map(|path| FileRecord { path: path.to_owned(), ..FileRecord::default() });
        model
    }

    #[test]
    fn a_model_belongs_to_the_hemisphere_of_its_files() {
        let own = Path::new("out/s1.rh.thickness.spharm.npz");
        let mut of_input = model(Kind::Signal, Some("surf/lh.thickness"));
        assert_eq!(of_input.hemisphere(Some(own)), Some(Hemisphere::Left));
        assert_eq!(model(Kind::Signal, Some("thickness.csv")).hemisphere(Some(own)), Some(Hemisphere::Right));
        assert_eq!(model(Kind::Signal, None).hemisphere(None), None);
        assert_eq!(of_input.anatomical_structure(), None);
        of_input.provenance.sphere = Some("surf/lh.sphere.reg".to_owned());
        assert_eq!(of_input.anatomical_structure().as_deref(), Some("CortexLeft"));
        of_input.provenance.anatomical_structure_primary = Some("CortexRight".to_owned());
        assert_eq!(of_input.hemisphere(Some(own)), Some(Hemisphere::Right));
        assert_eq!(of_input.anatomical_structure().as_deref(), Some("CortexRight"));
    }

    #[test]
    fn a_sphere_or_mask_of_the_other_hemisphere_is_found() {
        let of_input = |path: &str| model(Kind::Signal, Some(path)).provenance;
        let mut fitted = of_input("surf/lh.thickness");
        fitted.sphere = Some("surf/lh.sphere.reg".to_owned());
        assert_eq!(fitted.file_of_other_hemisphere(None), None);
        assert_eq!(fitted.file_of_other_hemisphere(Some("lh.cortex.label")), None);
        assert_eq!(fitted.file_of_other_hemisphere(Some("rh.medial.label")), Some("rh.medial.label"));
        fitted.region = Some(FileRecord { path: "rh.cortex.label".to_owned(), ..FileRecord::default() });
        assert_eq!(fitted.file_of_other_hemisphere(None), Some("rh.cortex.label"));
        // The hemisphere of the sphere is used if the hemisphere of the input is unknown.
        fitted.input = of_input("s1/thickness").input;
        assert_eq!(fitted.file_of_other_hemisphere(None), Some("rh.cortex.label"));
        fitted.input = of_input("surf/lh.thickness").input;
        fitted.sphere = Some("surf/rh.sphere.reg".to_owned());
        assert_eq!(fitted.file_of_other_hemisphere(None), Some("surf/rh.sphere.reg"));
        fitted.anatomical_structure_primary = Some("CortexRight".to_owned());
        assert_eq!(fitted.file_of_other_hemisphere(None), None, "metadata take precedence over file names");
        assert_eq!(of_input("thickness").file_of_other_hemisphere(None), None);
    }

    #[test]
    fn a_mirrored_model_belongs_to_the_other_hemisphere() {
        let mirror = json!([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let plain = json!([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let step = |antipodal: bool, object: &Value| json!({ "antipodal": antipodal, "object": object });
        for (kind, field, value, mirrored) in [
            (Kind::Surface, "transform", json!([step(true, &mirror), step(false, &plain)]), true),
            (Kind::Surface, "transform", json!([step(true, &mirror), step(true, &mirror)]), false),
            (Kind::Surface, "transform", json!([step(true, &plain), "smoothed"]), false),
            (Kind::Signal, "transform", json!([step(true, &plain)]), true),
            (Kind::Surface, "to_group", json!({ "orthogonal": mirror }), true),
            (Kind::Surface, "to_group", json!({ "orthogonal": plain }), false),
        ] {
            let mut model = model(kind, Some("rh.white"));
            model.provenance.other.insert(field.to_owned(), value.clone());
            let expected = if mirrored { Hemisphere::Left } else { Hemisphere::Right };
            assert_eq!(model.hemisphere(None), Some(expected), "{value}");
        }
    }
}
