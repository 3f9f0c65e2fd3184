//! The single test target for all tests that use the program or several crates, so that OpenBLAS is linked only once.

mod accuracy;
mod bad_input;
mod bare;
mod bids;
mod cohorts;
mod common;
mod compressed;
mod corpus;
mod correspond;
mod correspond_inputs;
mod denoise;
mod exchange;
mod facade;
mod first_users;
mod fit_arguments;
mod freesurfer;
mod full_least_squares;
mod handles;
mod hostile;
mod inputs;
mod labels;
#[cfg(target_os = "linux")]
mod linked;
mod memory;
mod mended;
mod moments;
mod moments_faults;
mod moments_schemes;
#[cfg(target_os = "linux")]
mod odd_files;
mod outputs;
#[cfg(feature = "paper")]
mod paper;
mod pipeline;
mod quality;
mod range;
mod readme;
mod report;
mod rerun_settings;
mod reruns;
mod resumed;
mod shape;
mod shape_inference;
mod shape_means;
mod shape_study;
mod store;
mod study;
mod study_again;
mod study_correspond;
mod study_tidy;
mod study_warnings;
mod surface_target;
mod verbs;
mod volume_tables;
mod volumes;
mod weights;
