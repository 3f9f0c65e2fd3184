//! Maps of many surfaces: one to one, with the promised quality, the same every time.

mod anisotropic;
mod cancelling;
mod handles;
mod label_files;
mod label_formats;
mod methods;
mod resample;
mod residual_areas;
mod robustness;
mod shapes;
mod shared_data;
mod volume;
