//! Registration in space: a template mesh moved onto the surfaces of subjects.
