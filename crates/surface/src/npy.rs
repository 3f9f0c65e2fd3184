//! Parses the headers of NumPy's array files (`.npy`), versions 1 to 3, for all readers.
//!
//! A file consists of the magic, the version, the length of the header, the header, and the values. The header is the
//! text of a Python dictionary with exactly three keys. The parser accepts only the following grammar, with blanks and
//! line breaks between the tokens:
//!
//! ```text
//! header = "{" entry ("," entry)* [","] "}"                 each key once
//! entry  = "'descr':" (type | "[" field ("," field)* [","] "]")
//!        | "'fortran_order':" ("True" | "False")
//!        | "'shape':" "(" [number ("," number)* [","]] ")"
//! field  = "(" string "," type ["," "(" [number ("," number)* [","]] ")"] ")"
//! type   = a string of "<", ">", "|" or "=", a letter, a number of bytes (of characters for "U"), and for "M" and "m"
//!          a unit of time in brackets
//! ```
//!
//! A field with a shape has the kind `V`: the readers treat it as uninterpreted bytes.
//!
//! A string is enclosed in single or double quotation marks, and has no escapes. The grammar doesn't nest, so the
//! parser never recurses. No memory is allocated based on a number in the header. Source: NumPy Enhancement Proposal 1,
//! and `numpy.lib.format`.

use std::io::{self, Read};

/// First bytes of a `.npy` file.
pub const MAGIC: &[u8] = b"\x93NUMPY";
/// Largest length of a header, in bytes. NumPy's own limit is 10,000 characters.
const LONGEST: usize = 1 << 16;
/// Largest number of axes, which is NumPy's own limit.
const MOST_AXES: usize = 64;

/// The contents of an array's header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Kind of the values, in NumPy's notation: `f` for floating-point numbers, `i` and `u` for signed and unsigned
    /// integers, `c` for complex numbers, `b` for Booleans, `U` for text, `M` and `m` for dates and times, `V` for a
    /// structured array and for a field with a shape.
    pub kind: char,
    /// Number of bytes per value.
    pub size: usize,
    /// Whether the values are little-endian.
    pub little: bool,
    /// Whether the first index varies fastest.
    pub fortran: bool,
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    /// For a structured array, the fields of each value, in order; empty for a plain array.
    pub fields: Vec<Field>,
    /// Position of the first value in the file, in bytes.
    pub start: u64,
}

/// A field of a structured array's values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name of the field.
    pub name: String,
    /// Kind of the field's values, in the notation of [`Header`].
    pub kind: char,
    /// Number of bytes of the field.
    pub size: usize,
    /// Whether the field is little-endian.
    pub little: bool,
}

impl Header {
    /// Reads a header. Afterwards, the input is positioned at the first value.
    ///
    /// # Errors
    ///
    /// The errors of reading from `input`; [`InvalidData`](io::ErrorKind::InvalidData) if `input` doesn't begin with a
    /// valid header.
    pub fn read(input: &mut dyn Read) -> io::Result<Self> {
        let invalid = |text: String| io::Error::new(io::ErrorKind::InvalidData, text);
        let mut begin = [0; 8];
        input.read_exact(&mut begin)?;
        let (length, before) = match begin {
            [magic @ .., 1, _] if magic == MAGIC => {
                let mut length = [0; 2];
                input.read_exact(&mut length)?;
                (u16::from_le_bytes(length).into(), 10)
            }
            [magic @ .., 2 | 3, _] if magic == MAGIC => {
                let mut length = [0; 4];
                input.read_exact(&mut length)?;
                (u32::from_le_bytes(length) as usize, 12)
            }
            _ => return Err(invalid("not a NumPy file of format version 1 to 3".to_owned())),
        };
        if length > LONGEST {
            return Err(invalid(format!("expected a header of at most {LONGEST} bytes, found {length}")));
        }
        let mut text = vec![0; length];
        input.read_exact(&mut text)?;
        let text = String::from_utf8(text).map_err(|_| invalid("the header isn't UTF-8 text".to_owned()))?;
        let header = Parser { text: &text, rest: &text }.header();
        let header = header.map_err(|problem| invalid(format!("a header that can't be parsed: {problem}")))?;
        Ok(Self { start: (before + length) as u64, ..header })
    }

    /// Returns the number of values; `None` on overflow.
    #[must_use]
    pub fn count(&self) -> Option<u64> {
        self.shape.iter().try_fold(1_u64, |product, &n| product.checked_mul(n as u64))
    }

    /// Returns the number of bytes of all values; `None` on overflow.
    #[must_use]
    pub fn bytes(&self) -> Option<u64> {
        self.count()?.checked_mul(self.size as u64)
    }
}

/// The type of a value or field.
struct Type {
    kind: char,
    size: usize,
    little: bool,
}

impl Type {
    fn parse(text: &str) -> Option<Self> {
        let (rest, order) = match text.chars().next()? {
            order @ ('<' | '>' | '|' | '=') => (text.get(1..)?, order),
            _ => (text, '='),
        };
        let kind = rest.chars().next().filter(char::is_ascii_alphabetic)?;
        let (kind, digits) = match (kind, rest.get(1..)?.split_once('[')) {
            ('M' | 'm', Some((digits, unit))) if unit.ends_with(']') => (kind, digits),
            _ => (kind, rest.get(1..)?),
        };
        let digits = Some(digits).filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()))?;
        let size: usize = digits.parse().ok()?;
        // In NumPy's strings, each character has four bytes. Strings may be empty. Other values of size 0 are rejected,
        // since a file without bytes could claim any number of them.
        let size = if kind == 'U' { size.checked_mul(4)? } else { Some(size).filter(|&size| size > 0)? };
        let little = if order == '=' { cfg!(target_endian = "little") } else { order != '>' };
        Some(Self { kind, size, little })
    }
}

/// The text of a header, and the part that isn't parsed yet.
struct Parser<'a> {
    text: &'a str,
    rest: &'a str,
}

impl<'a> Parser<'a> {
    fn header(mut self) -> Result<Header, String> {
        let (mut types, mut fortran, mut shape) = (None, None, None);
        self.expect("{")?;
        loop {
            if self.take("}") {
                break;
            }
            let key = self.string()?;
            self.expect(":")?;
            let again = match key {
                "descr" => types.replace(self.types()?).is_some(),
                "fortran_order" => fortran.replace(self.truth()?).is_some(),
                "shape" => shape.replace(self.shape()?).is_some(),
                _ => return Err(format!("expected the keys descr, fortran_order and shape, found {}", shown(key))),
            };
            if again {
                return Err(format!("the key {key:?} occurs twice"));
            }
            if !self.take(",") {
                self.expect("}")?;
                break;
            }
        }
        self.blanks();
        if !self.rest.is_empty() {
            return Err(self.expected("the end of the header"));
        }
        let (Some((own, fields)), Some(fortran), Some(shape)) = (types, fortran, shape) else {
            return Err("expected the keys descr, fortran_order and shape, found fewer".to_owned());
        };
        let Type { kind, size, little } = own;
        Ok(Header { kind, size, little, fortran, shape, fields, start: 0 })
    }

    fn types(&mut self) -> Result<(Type, Vec<Field>), String> {
        if !self.take("[") {
            return Ok((self.one_type()?, Vec::new()));
        }
        let fields = self.items("]", |parser| {
            parser.expect("(")?;
            let name = parser.string()?.to_owned();
            parser.expect(",")?;
            let own = |problem| format!("field {}: {problem}", shown(&name));
            let Type { mut kind, mut size, little } = parser.one_type().map_err(own)?;
            if parser.take(",") {
                let shape = parser.shape().map_err(own)?;
                let whole = shape.iter().try_fold(size, |product, &n| product.checked_mul(n));
                size = whole.ok_or_else(|| own("more bytes than memory can address".to_owned()))?;
                kind = 'V';
            }
            parser.expect(")").map_err(own)?;
            Ok(Field { name, kind, size, little })
        })?;
        let size = fields.iter().try_fold(0_usize, |sum, field| sum.checked_add(field.size));
        let size = size.filter(|&size| size > 0).ok_or("expected fields of at least one byte in total")?;
        Ok((Type { kind: 'V', size, little: true }, fields))
    }

    fn one_type(&mut self) -> Result<Type, String> {
        let text = self.string()?;
        Type::parse(text).ok_or_else(|| format!("expected a type such as <f8, found {}", shown(text)))
    }

    fn truth(&mut self) -> Result<bool, String> {
        if self.take("True") {
            return Ok(true);
        }
        if self.take("False") { Ok(false) } else { Err(self.expected("True or False")) }
    }

    fn shape(&mut self) -> Result<Vec<usize>, String> {
        self.expect("(")?;
        let shape = self.items(")", Self::number)?;
        if shape.len() <= MOST_AXES { Ok(shape) } else { Err(format!("expected at most {MOST_AXES} axes, found more")) }
    }

    /// Parses items separated by commas, up to and including the closing token.
    fn items<T>(
        &mut self,
        close: &'static str,
        mut item: impl FnMut(&mut Self) -> Result<T, String>,
    ) -> Result<Vec<T>, String> {
        let mut items = Vec::new();
        while !self.take(close) {
            items.push(item(self)?);
            if !self.take(",") {
                self.expect(close)?;
                break;
            }
        }
        Ok(items)
    }

    fn number(&mut self) -> Result<usize, String> {
        self.blanks();
        let digits = self.rest.bytes().take_while(u8::is_ascii_digit).count();
        let number = self.rest.get(..digits).and_then(|digits| digits.parse().ok());
        let number = number.ok_or_else(|| self.expected("the length of an axis"))?;
        self.rest = self.rest.get(digits..).unwrap_or_default();
        // Python 2 writes long integers with the suffix L.
        self.rest = self.rest.strip_prefix('L').unwrap_or(self.rest);
        Ok(number)
    }

    fn string(&mut self) -> Result<&'a str, String> {
        self.blanks();
        let quote = self.rest.chars().next().filter(|c| matches!(c, '\'' | '"'));
        let found = quote.and_then(|quote| self.rest.get(1..)?.split_once(quote));
        let Some((text, rest)) = found.filter(|(text, _)| !text.contains('\\')) else {
            return Err(self.expected("a quoted string without escapes"));
        };
        self.rest = rest;
        Ok(text)
    }

    fn expect(&mut self, token: &'static str) -> Result<(), String> {
        if self.take(token) { Ok(()) } else { Err(self.expected(token)) }
    }

    fn take(&mut self, token: &str) -> bool {
        self.blanks();
        let rest = self.rest.strip_prefix(token);
        self.rest = rest.unwrap_or(self.rest);
        rest.is_some()
    }

    fn blanks(&mut self) {
        self.rest = self.rest.trim_start_matches([' ', '\t', '\r', '\n']);
    }

    fn expected(&self, what: &str) -> String {
        let at = self.text.len() - self.rest.len();
        let found = if self.rest.is_empty() { "the end".to_owned() } else { shown(self.rest) };
        format!("expected {what} at character {at}, found {found}")
    }
}

/// Returns text from a file, shortened and in printable form.
fn shown(text: &str) -> String {
    const MOST: usize = 32;
    let more = if text.chars().nth(MOST).is_some() { "..." } else { "" };
    format!("{:?}{more}", text.chars().take(MOST).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> io::Result<Header> {
        let file = [MAGIC, &[2, 0], &(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
        Header::read(&mut &file[..])
    }

    #[test]
    fn headers_of_numpy_are_read() {
        let text = "{'descr': '>f4', 'fortran_order': True, 'shape': (2, 3), }          \n";
        let header = read(text).unwrap();
        let expected = (('f', 4, false, true), &[2, 3][..], 12 + text.len() as u64);
        assert_eq!(
            ((header.kind, header.size, header.little, header.fortran), &header.shape[..], header.start),
            expected
        );
        assert_eq!((header.count(), header.bytes()), (Some(6), Some(24)));
        // The first header has its keys in another order, both kinds of quotation marks, and a length as written by
        // Python 2. The second header is that of an array without axes.
        let header = read("{\"shape\": (7L,), 'fortran_order':False,'descr':'|u1'}").unwrap();
        assert_eq!((header.kind, header.shape, header.little), ('u', vec![7], true));
        assert_eq!(read("{'descr': '<U3', 'fortran_order': False, 'shape': (), }\n").unwrap().bytes(), Some(12));
        let text = "{'descr': [('lon', '<f8'), (\"it's\", '>i2')], 'fortran_order': False, 'shape': (5,), }";
        let header = read(text).unwrap();
        let fields: Vec<_> = header.fields.iter().map(|f| (f.name.as_str(), f.kind, f.size, f.little)).collect();
        assert_eq!(fields, [("lon", 'f', 8, true), ("it's", 'i', 2, false)]);
        assert_eq!((header.kind, header.size, header.bytes()), ('V', 10, Some(50)));
        let text =
            "{'descr': [('t', '<M8[ns]'), ('x', '<f4', (2, 3)), ('h', '<f8')], 'fortran_order': False, 'shape': (5,)}";
        let fields: Vec<_> = read(text).unwrap().fields.iter().map(|f| (f.kind, f.size)).collect();
        assert_eq!(fields, [('M', 8), ('V', 24), ('f', 8)]);
    }

    #[test]
    fn what_is_no_header_is_refused_in_one_short_line() {
        let deep = format!("{{'descr': {}", "[(".repeat(20_000));
        let axes = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}), }}", "1,".repeat(65));
        for text in [
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'shape': (4398046511104,), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1,), \"descr\": '<f4'}",
            "{'descr': '<f8', 'fortran_order': False}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'more': 1}",
            "{'descr': '<f8', 'fortran_order': 1, 'shape': (1,)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999,)}",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1,)} os.remove('x')",
            "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '|V0', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '<f8\x1b[2J\n\x07', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '<U4611686018427387904', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': [('a', '<f8', (4398046511104, 4398046511104))], 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '<M8[s', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': [], 'fortran_order': False, 'shape': (1,)}",
            "{'a\\'': 1}",
            "",
            &deep,
            &axes,
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.len() < 160 && !message.contains(char::is_control), "{message}");
        }
        assert_eq!(
            read("{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 9999999999)}").unwrap().bytes(),
            None
        );
        assert!(read(&" ".repeat(LONGEST + 1)).is_err());
    }
}
