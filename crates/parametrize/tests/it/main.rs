//! Maps of many surfaces: one to one, as good as promised, the same every time.

mod methods;
mod robustness;
mod room;
mod shapes;
mod shared_data;
