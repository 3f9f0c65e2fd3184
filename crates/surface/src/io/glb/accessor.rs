//! Reads arrays. An array is described by an accessor, which refers to bytes in a view of a buffer (sections 3.6.2 and
//! 5.1 of the glTF specification).
//!
//! Elements start at the view's offset plus the accessor's offset and are `stride` bytes apart. A sparse accessor
//! replaces some elements of its array, or of an array of zeros if the accessor has no array. All bounds are checked
//! before memory is allocated.

use super::super::budget::Budget;
use super::super::bytes::{Cursor, Endian};
use super::super::flaw::Flaw;
use super::super::scalar::Scalar;
use super::container::Buffer;
use super::document::{Accessor, BufferView, Document, Primitive, Sparse};

/// Returns the number type with the given glTF code (`componentType`).
fn component(code: u64) -> Result<Scalar, Flaw> {
    Ok(match code {
        5120 => Scalar::I8,
        5121 => Scalar::U8,
        5122 => Scalar::I16,
        5123 => Scalar::U16,
        5125 => Scalar::U32,
        5126 => Scalar::F32,
        other => return Err(Flaw::new("a componentType from 5120 to 5126", other.to_string())),
    })
}

fn is_unsigned(component: Scalar) -> bool {
    matches!(component, Scalar::U8 | Scalar::U16 | Scalar::U32)
}

/// Returns the number encoded in the first of the given bytes. Returns 0 if there are too few bytes, which callers rule
/// out.
fn number(component: Scalar, bytes: &[u8]) -> f64 {
    component.read(&mut Cursor::new(bytes), Endian::Little).unwrap_or(0.0)
}

/// Returns the number by which normalised integers are divided (section 3.11).
fn most(component: Scalar) -> f64 {
    match component {
        Scalar::I8 => 127.0,
        Scalar::U8 => 255.0,
        Scalar::I16 => 32767.0,
        Scalar::U16 => 65535.0,
        _ => 1.0,
    }
}

/// A document and the buffers from which its arrays are read.
pub(super) struct Arrays<'a> {
    pub(super) document: &'a Document,
    pub(super) buffers: &'a [Buffer<'a>],
}

impl Arrays<'_> {
    /// Returns the positions of an accessor.
    pub(super) fn positions(
        &self,
        accessor: usize,
        primitive: &Primitive,
        budget: &mut Budget,
    ) -> Result<Vec<[f64; 3]>, Flaw> {
        let accessor = self.accessor(accessor)?;
        let kind = component(accessor.component_type)?;
        let is_integer = matches!(kind, Scalar::I8 | Scalar::U8 | Scalar::I16 | Scalar::U16);
        if accessor.kind != "VEC3" || kind != Scalar::F32 && !(is_integer && self.document.is_quantized()) {
            return Err(found_type("positions of three 32-bit floats each", accessor));
        }
        let size = kind.size();
        let coordinate = |bytes: &[u8]| {
            let value = number(kind, bytes);
            if accessor.normalized { (value / most(kind)).max(-1.0) } else { value }
        };
        self.values(accessor, 3 * size, primitive, budget, |bytes| {
            let mut position = [0.0; 3];
            position.iter_mut().zip(bytes.chunks(size)).for_each(|(x, bytes)| *x = coordinate(bytes));
            position
        })
    }

    /// Returns the indices of an accessor.
    pub(super) fn indices(
        &self,
        accessor: usize,
        primitive: &Primitive,
        budget: &mut Budget,
    ) -> Result<Vec<u32>, Flaw> {
        let accessor = self.accessor(accessor)?;
        let kind = component(accessor.component_type)?;
        if accessor.kind != "SCALAR" || !is_unsigned(kind) {
            return Err(found_type("unsigned whole numbers as indices", accessor));
        }
        self.values(accessor, kind.size(), primitive, budget, |bytes| number(kind, bytes) as u32)
    }

    /// Returns the elements of an accessor, each converted from `size` bytes. The elements are charged to the memory
    /// budget, because an accessor of zeros takes no bytes in the file, and an accessor can be used several times.
    fn values<T: Clone + Default>(
        &self,
        accessor: &Accessor,
        size: usize,
        primitive: &Primitive,
        budget: &mut Budget,
        convert: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, Flaw> {
        budget.spend(accessor.count.saturating_mul(size_of::<T>() as u64), "arrays of")?;
        let count = usize::try_from(accessor.count)
            .map_err(|_| Flaw::new("arrays that fit in memory", accessor.count.to_string()))?;
        let mut values = match (accessor.buffer_view, &accessor.sparse) {
            (Some(view), _) => self.elements(view, accessor.byte_offset, accessor.count, size)?.map(&convert).collect(),
            (None, Some(_)) => vec![T::default(); count],
            (None, None) => return Err(primitive.without_data()),
        };
        let Some(Sparse { count, indices, values: replaced }) = &accessor.sparse else { return Ok(values) };
        let kind = component(indices.component_type)?;
        if !is_unsigned(kind) {
            return Err(Flaw::new("unsigned whole numbers as sparse indices", indices.component_type.to_string()));
        }
        let places = self.elements(indices.buffer_view, indices.byte_offset, *count, kind.size())?;
        let replaced = self.elements(replaced.buffer_view, replaced.byte_offset, *count, size)?;
        for (place, bytes) in places.zip(replaced) {
            let place = number(kind, place) as usize;
            let length = values.len();
            let value = values.get_mut(place);
            *value.ok_or_else(|| Flaw::new(format!("sparse indices below {length}"), place.to_string()))? =
                convert(bytes);
        }
        Ok(values)
    }

    /// Returns the bytes of `count` elements of `size` bytes each in a view, starting at `offset`.
    fn elements(&self, view: usize, offset: u64, count: u64, size: usize) -> Result<impl Iterator<Item = &[u8]>, Flaw> {
        let found = self.document.buffer_views.get(view);
        let found = found.ok_or_else(|| Flaw::new("the number of an existing buffer view", view.to_string()))?;
        let stride = match found.byte_stride {
            None => size as u64,
            Some(stride) if (4..=252).contains(&stride) => stride,
            Some(stride) => return Err(Flaw::new("a byteStride from 4 to 252", stride.to_string())),
        };
        let bytes = self.bytes(found)?;
        // The last element needn't be followed by the unused bytes that separate elements.
        let end = |last: u64| last.checked_mul(stride)?.checked_add(offset)?.checked_add(size as u64);
        let needed = count.checked_sub(1).map_or(Some(0), end);
        if needed.is_none_or(|needed| needed > bytes.len() as u64) {
            return Err(Flaw::new(
                format!("{count} elements in buffer view {view}, from byte {offset} on"),
                format!("a view of {} bytes", bytes.len()),
            ));
        }
        let place = move |number: u64| (offset + number * stride) as usize;
        Ok((0..count).filter_map(move |number| bytes.get(place(number)..place(number) + size)))
    }

    /// Returns the bytes of a view.
    fn bytes(&self, view: &BufferView) -> Result<&[u8], Flaw> {
        let bytes = match self.buffers.get(view.buffer) {
            Some(Buffer::Bytes(bytes)) => bytes,
            Some(Buffer::Absent) => return Err(view.without_data()),
            Some(Buffer::External(uri)) => {
                return Err(Flaw::unsupported(
                    format!("data in another file ({uri})"),
                    "export the scene as one file: .glb, or .gltf with embedded data",
                ));
            }
            None => return Err(Flaw::new("the number of an existing buffer", view.buffer.to_string())),
        };
        let range = usize::try_from(view.byte_offset).ok().zip(usize::try_from(view.byte_length).ok());
        range.and_then(|(start, length)| bytes.get(start..start.checked_add(length)?)).ok_or_else(|| {
            Flaw::new(
                format!(
                    "a buffer view of {} bytes from byte {} on, within its buffer",
                    view.byte_length, view.byte_offset
                ),
                format!("a buffer of {} bytes", bytes.len()),
            )
        })
    }

    fn accessor(&self, number: usize) -> Result<&Accessor, Flaw> {
        let accessor = self.document.accessors.get(number);
        accessor.ok_or_else(|| Flaw::new("the number of an existing accessor", number.to_string()))
    }
}

fn found_type(expected: &str, accessor: &Accessor) -> Flaw {
    Flaw::new(expected, format!("{} of componentType {}", accessor.kind, accessor.component_type))
}
