//! One test target for everything that goes through the binaries or across crates, so that OpenBLAS is linked once.

mod accuracy;
mod bad_input;
mod bare;
mod common;
mod compressed;
mod denoise;
mod facade;
mod first_users;
mod fit_arguments;
mod full_least_squares;
mod handles;
mod inputs;
mod memory;
mod moments;
mod moments_faults;
mod paper;
mod pipeline;
mod readme;
mod report;
mod reruns;
mod shape;
mod shape_study;
mod store;
mod surface_target;
mod verbs;
mod volumes;
