//! Parses a GIfTI document: its metadata and its DataArrays, each decoded as soon as its Data element ends.

use std::borrow::Cow;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::super::flaw::{Flaw, shown};
use super::super::text::{number, words};
use super::super::xml::resolve;
use super::data::{Array, Description, decode};
use crate::mesh::CoordinateSystem;
use crate::room::most_expanded;

/// The contents of a GIfTI file.
#[derive(Debug, Default)]
pub(super) struct Document {
    pub(super) metadata: Vec<(String, String)>,
    pub(super) arrays: Vec<DataArray>,
    /// Keys and names of the LabelTable.
    pub(super) labels: super::LabelTable,
}

/// A DataArray: its metadata and its decoded values.
#[derive(Debug, Default)]
pub(super) struct DataArray {
    pub(super) intent: String,
    pub(super) metadata: Vec<(String, String)>,
    pub(super) coordinate_system: Option<CoordinateSystem>,
    pub(super) values: Array,
}

/// Largest nesting depth. No valid document is deeper, and a document that consists only of opening tags is rejected
/// early.
const DEEPEST: usize = 16;

/// The elements whose text is used; all others are `Other`.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Leaf {
    Name,
    Value,
    DataSpace,
    TransformedSpace,
    MatrixData,
    Data,
    Label,
    Other,
}

#[derive(Default)]
struct State<'a> {
    document: Document,
    /// Number of bytes that the remaining compressed data may expand to.
    left: u64,
    /// The open elements, the innermost last.
    open: Vec<Leaf>,
    /// Whether the root element has begun.
    root: bool,
    /// The current DataArray, its attributes, and whether its data has been read.
    array: Option<(DataArray, Description, bool)>,
    /// The text of the innermost element, as read so far.
    text: Cow<'a, str>,
    name: String,
    /// Key of the current Label.
    key: Option<i64>,
    system: Option<CoordinateSystem>,
}

/// Parses the text of a GIfTI file.
pub(super) fn parse(text: &str) -> Result<Document, Flaw> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let mut state = State { left: most_expanded(text.len() as u64), ..State::default() };
    loop {
        let event = reader.read_event().map_err(|e| {
            let at = reader.error_position();
            Flaw::new("well-formed XML", format!("an error at byte {at}: {e}"))
        })?;
        match event {
            Event::Start(tag) => state.start(&tag)?,
            Event::End(tag) => state.end(tag.name().as_ref())?,
            Event::Text(t) => state.push(t.into_inner()),
            Event::CData(t) => state.push(t.into_inner()),
            Event::GeneralRef(r) => state.push(resolve(&r)?.into()),
            Event::Eof => break,
            // `Empty` doesn't occur, because `expand_empty_elements` is set; the other events are ignored.
            Event::Empty(_) | Event::Comment(_) | Event::Decl(_) | Event::PI(_) | Event::DocType(_) => {}
        }
    }
    if !state.root {
        return Err(Flaw::new("a GIFTI element", "none"));
    }
    if !state.open.is_empty() {
        return Err(Flaw::new("</GIFTI> at the end", "the end of the file"));
    }
    Ok(state.document)
}

impl<'a> State<'a> {
    fn push(&mut self, text: Cow<'a, str>) {
        // The numbers of a surface arrive as a single borrowed piece, which isn't copied.
        if self.text.is_empty() {
            self.text = text;
        } else {
            self.text.to_mut().push_str(&text);
        }
    }

    fn start(&mut self, tag: &BytesStart<'_>) -> Result<(), Flaw> {
        let name = tag.name();
        let name: &[u8] = name.as_ref().as_ref();
        if self.open.is_empty() {
            if name != b"GIFTI" || self.root {
                return Err(Flaw::new("a single GIFTI element at the top level", shown(name)));
            }
            self.root = true;
        }
        if self.open.len() >= DEEPEST {
            return Err(Flaw::new(format!("elements nested at most {DEEPEST} deep"), "deeper nesting".to_owned()));
        }
        match name {
            b"DataArray" => {
                if self.array.is_some() {
                    return Err(Flaw::new("</DataArray>", "another DataArray inside"));
                }
                self.array = Some(attributes(tag)?);
            }
            b"CoordinateSystemTransformMatrix" => {
                self.system = Some(CoordinateSystem {
                    data_space: String::new(),
                    transformed_space: String::new(),
                    matrix: [0.0; 16],
                });
            }
            b"MD" => self.name.clear(),
            b"Label" => self.key = key(tag)?,
            _ => {}
        }
        self.open.push(match name {
            b"Name" => Leaf::Name,
            b"Value" => Leaf::Value,
            b"DataSpace" => Leaf::DataSpace,
            b"TransformedSpace" => Leaf::TransformedSpace,
            b"MatrixData" => Leaf::MatrixData,
            b"Data" => Leaf::Data,
            b"Label" => Leaf::Label,
            _ => Leaf::Other,
        });
        self.text = Cow::default();
        Ok(())
    }

    fn end<N: AsRef<[u8]>>(&mut self, name: N) -> Result<(), Flaw> {
        // quick-xml has checked that the closing tag matches the opening tag.
        let leaf = self.open.pop().unwrap_or(Leaf::Other);
        let text = std::mem::take(&mut self.text);
        match leaf {
            Leaf::Name => self.name = text.trim().to_owned(),
            Leaf::Value => {
                let pair = (std::mem::take(&mut self.name), text.into_owned());
                match &mut self.array {
                    Some((array, ..)) => array.metadata.push(pair),
                    None => self.document.metadata.push(pair),
                }
            }
            Leaf::Label => {
                if let Some(key) = self.key.take() {
                    self.document.labels.push((key, text.trim().to_owned()));
                }
            }
            Leaf::DataSpace => self.in_system(|s| s.data_space = text.trim().to_owned()),
            Leaf::TransformedSpace => self.in_system(|s| s.transformed_space = text.trim().to_owned()),
            Leaf::MatrixData => {
                let matrix = matrix(&text)?;
                self.in_system(|s| s.matrix = matrix);
            }
            Leaf::Data => {
                if let Some((array, description, has_data)) = &mut self.array {
                    if *has_data {
                        return Err(Flaw::new("one Data element per DataArray", "two"));
                    }
                    array.values = decode(description, &text, &mut self.left)?;
                    *has_data = true;
                }
            }
            Leaf::Other => match name.as_ref() {
                b"DataArray" => self.end_array()?,
                b"CoordinateSystemTransformMatrix" => {
                    let system = self.system.take();
                    if let Some((array, ..)) = &mut self.array {
                        // If an array has several coordinate systems, the first is used, as in other programs.
                        array.coordinate_system = array.coordinate_system.take().or(system);
                    }
                }
                _ => {}
            },
        }
        Ok(())
    }

    fn in_system(&mut self, set: impl FnOnce(&mut CoordinateSystem)) {
        if let Some(system) = &mut self.system {
            set(system);
        }
    }

    fn end_array(&mut self) -> Result<(), Flaw> {
        match self.array.take() {
            Some((array, _, true)) => {
                self.document.arrays.push(array);
                Ok(())
            }
            _ => Err(Flaw::new("a Data element in each DataArray", "none")),
        }
    }
}

/// Returns the key of a Label element. Early files call this attribute Index.
fn key(tag: &BytesStart<'_>) -> Result<Option<i64>, Flaw> {
    for attribute in tag.attributes() {
        let attribute = attribute.map_err(|e| Flaw::new("valid XML attributes", e.to_string()))?;
        let name: &[u8] = attribute.key.as_ref().as_ref();
        if [b"Key".as_slice(), b"Index"].contains(&name) {
            // A label whose key isn't a whole number is skipped, since most callers don't need the labels.
            return Ok(number(attribute.value.trim().as_bytes()));
        }
    }
    Ok(None)
}

fn attributes(tag: &BytesStart<'_>) -> Result<(DataArray, Description, bool), Flaw> {
    let mut array = DataArray::default();
    let mut description = Description::default();
    for attribute in tag.attributes() {
        let attribute = attribute.map_err(|e| Flaw::new("valid XML attributes", e.to_string()))?;
        let value = attribute
            .normalized_value(quick_xml::XmlVersion::Implicit1_0)
            .map_err(|e| Flaw::new("valid XML attributes", e.to_string()))?
            .into_owned();
        let key: &[u8] = attribute.key.as_ref().as_ref();
        match key {
            b"Intent" => array.intent = value,
            b"DataType" => description.data_type = value,
            b"ArrayIndexingOrder" => description.order = value,
            b"Encoding" => description.encoding = value,
            b"Endian" => description.endian = value,
            b"Dimensionality" => description.dimensionality = value,
            [b'D', b'i', b'm', digit @ b'0'..=b'5'] => {
                if let Some(slot) = description.dimensions.get_mut(usize::from(digit - b'0')) {
                    *slot = Some(value);
                }
            }
            _ => {}
        }
    }
    Ok((array, description, false))
}

fn matrix(text: &str) -> Result<[f64; 16], Flaw> {
    let mut matrix = [0.0; 16];
    let mut numbers = words(text.as_bytes());
    for x in &mut matrix {
        let word = numbers.next().unwrap_or_default();
        *x = number(word)
            .filter(|x: &f64| x.is_finite())
            .ok_or_else(|| Flaw::new("16 numbers in MatrixData", shown(word)))?;
    }
    Ok(matrix)
}
