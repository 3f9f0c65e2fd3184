//! Fast synthesis and adjoint synthesis of spherical harmonics at scattered directions.
