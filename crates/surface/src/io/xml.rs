//! Walks through the elements of an XML document. The prefixes of names are ignored.

use std::borrow::Cow;

use quick_xml::Reader;
use quick_xml::events::{BytesRef, BytesStart, Event};

use super::flaw::{Flaw, shown};
use super::text::number;

/// Largest nesting depth. No valid document is deeper, and a document that consists only of opening tags is rejected
/// early.
const DEEPEST: usize = 16;

/// A part of a document.
pub(super) enum Step<'s, 'a> {
    /// An opening tag. An empty element is passed as an opening and a closing tag.
    Start(&'s Tag<'a>),
    /// A piece of text. Each character or entity reference is a separate piece.
    Text(Cow<'a, str>),
    /// The closing tag of the element with this name.
    End(&'s str),
}

/// An opening tag.
pub(super) struct Tag<'a>(BytesStart<'a>);

impl Tag<'_> {
    pub(super) fn name(&self) -> &str {
        self.0.local_name().into_inner()
    }

    /// Passes the name and the value of each attribute to `each`. The name includes its prefix; see [`local`].
    pub(super) fn attributes(&self, mut each: impl FnMut(&str, Cow<'_, str>) -> Result<(), Flaw>) -> Result<(), Flaw> {
        // The checks for repeated attribute names are disabled, because their time grows with the square of the number
        // of attributes.
        for attribute in self.0.attributes().with_checks(false) {
            let attribute = attribute.map_err(|e| Flaw::new("valid XML attributes", e.to_string()))?;
            let value = attribute
                .normalized_value(quick_xml::XmlVersion::Implicit1_0)
                .map_err(|e| Flaw::new("valid XML attributes", e.to_string()))?;
            each(attribute.key.into_inner(), value)?;
        }
        Ok(())
    }

    /// Returns the value of an attribute.
    pub(super) fn attribute(&self, name: &str) -> Result<Option<String>, Flaw> {
        let mut found = None;
        self.attributes(|key, value| {
            if local(key) == name {
                found = Some(value.into_owned());
            }
            Ok(())
        })?;
        Ok(found)
    }

    /// Returns the value of an attribute as a number, if the attribute exists.
    pub(super) fn number<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, Flaw> {
        let Some(text) = self.attribute(name)? else { return Ok(None) };
        match number(text.trim().as_bytes()) {
            Some(value) => Ok(Some(value)),
            None => Err(Flaw::new(
                format!("a number as the attribute {name} of the element {}", self.name()),
                shown(text.as_bytes()),
            )),
        }
    }
}

/// Returns a name without its prefix.
pub(super) fn local(name: &str) -> &str {
    name.split_once(':').map_or(name, |(_, local)| local)
}

/// Passes every part of a document to `visit`. If `whole` is false, the document may end within elements.
pub(super) fn walk<'a>(
    text: &'a str,
    whole: bool,
    mut visit: impl FnMut(Step<'_, 'a>) -> Result<(), Flaw>,
) -> Result<(), Flaw> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let (mut depth, mut roots) = (0_usize, 0_usize);
    loop {
        let event = reader.read_event().map_err(|e| {
            let at = reader.error_position();
            Flaw::new("well-formed XML", format!("an error at byte {at}: {e}"))
        })?;
        match event {
            Event::Start(tag) => {
                roots += usize::from(depth == 0);
                depth += 1;
                if depth > DEEPEST || roots > 1 {
                    return Err(Flaw::new(
                        format!("one root element, with others nested at most {DEEPEST} deep"),
                        "several root elements, or deeper nesting",
                    ));
                }
                visit(Step::Start(&Tag(tag)))?;
            }
            Event::End(tag) => {
                depth = depth.saturating_sub(1);
                visit(Step::End(tag.local_name().into_inner()))?;
            }
            Event::Text(text) => visit(Step::Text(text.into_inner()))?,
            Event::CData(text) => visit(Step::Text(text.into_inner()))?,
            Event::GeneralRef(reference) => visit(Step::Text(resolve(&reference)?.into()))?,
            Event::Eof => break,
            // `Empty` doesn't occur, because `expand_empty_elements` is set; the other events are ignored.
            Event::Empty(_) | Event::Comment(_) | Event::Decl(_) | Event::PI(_) | Event::DocType(_) => {}
        }
    }
    if roots == 0 {
        return Err(Flaw::new("an XML document", shown(text.as_bytes())));
    }
    if whole && depth > 0 {
        return Err(Flaw::new("the closing tag of each element", "the end of the file"));
    }
    Ok(())
}

/// Resolves XML's predefined entities and character references. Other entities would require a DTD, which isn't read.
pub(super) fn resolve(reference: &BytesRef<'_>) -> Result<String, Flaw> {
    if let Ok(Some(c)) = reference.resolve_char_ref() {
        return Ok(c.into());
    }
    let name = reference.xml10_content();
    match quick_xml::escape::resolve_xml_entity(&name) {
        Some(text) => Ok(text.into()),
        None => Err(Flaw::new("only XML's predefined entities", shown(name.as_bytes()))),
    }
}
