//! spharm
