//! Tests that the maps of many surfaces are one to one, reproducible, and of the promised quality.

mod anisotropic;
mod cancelling;
mod grey;
mod handles;
mod label_descriptions;
mod label_files;
mod label_formats;
mod methods;
mod resample;
mod residual_areas;
mod robustness;
mod shapes;
mod shared_data;
mod volume;
mod wrap;
