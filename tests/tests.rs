//! One test target for everything that goes through the binaries or across crates, so that OpenBLAS is linked once.

mod common;
