//! Reads TIFF stacks (`.tif`, `.tiff`, OME-TIFF): one page per slice, channel and time.
//!
//! The crate `tiff` decodes the pages, within a memory limit derived from the file's size. The size of the voxels, in
//! micrometres, is computed from the description of the first page: from OME-XML's `PhysicalSizeX`, `Y`, `Z`, or from
//! ImageJ's `spacing` and `unit` and the page's resolution. The numbers of channels and time points are also taken from
//! this description, or from tifffile's. Sources: OME-TIFF specification 6.0; ImageJ's `TiffEncoder`.

use std::io::Cursor;

use quick_xml::Reader;
use quick_xml::events::Event;
use spharm_monitor::Stage;
use spharm_surface::io::MOST_EXPANSION;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::shaped::{self, Images};
use super::source::Source;
use super::values::{Collector, Volume};
use crate::error::ParametrizeError;

/// Largest number of bytes of a page: 32,768 x 32,768 values of 8 bits.
const LARGEST_PAGE: u64 = 1 << 30;

/// Descriptions of files whose OME-XML lacks the size of the voxels along x, y or z.
const OME_WITHOUT_SIZE: [&str; 3] = [
    "a TIFF file whose OME-XML lacks PhysicalSizeX",
    "a TIFF file whose OME-XML lacks PhysicalSizeY",
    "a TIFF file whose OME-XML lacks PhysicalSizeZ",
];
/// Descriptions of files whose OME-XML has the size of the voxels along x, y or z in an unknown unit.
const OME_WITHOUT_UNIT: [&str; 3] = [
    "a TIFF file whose OME-XML has an unknown PhysicalSizeXUnit",
    "a TIFF file whose OME-XML has an unknown PhysicalSizeYUnit",
    "a TIFF file whose OME-XML has an unknown PhysicalSizeZUnit",
];

/// Returns whether a file begins like a TIFF or BigTIFF file.
pub(super) fn is_tiff(bytes: &[u8]) -> bool {
    [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| bytes.starts_with(*magic))
}

/// The facts about the entire stack that the first page's description states.
#[derive(Debug, PartialEq)]
struct Description {
    /// Size of the voxels in micrometres, or a description of the file that states why the size is missing.
    voxel_size: Result<[f64; 3], &'static str>,
    /// Number of slices, if the description states it.
    slices: Option<usize>,
    channels: usize,
    times: usize,
    /// Order of the pages: the axes Z, C and T, the fastest-varying axis first.
    order: [u8; 3],
    /// Whether the description places pages in an order other than `order`, or in other files.
    elsewhere: bool,
}

impl Description {
    /// The description of a file that contains one image.
    const ONE: Self = Self {
        voxel_size: Err("a TIFF file without OME-XML or ImageJ's spacing"),
        slices: None,
        channels: 1,
        times: 1,
        order: *b"ZCT",
        elsewhere: false,
    };

    /// Returns the indices of a page's slice, channel and time in a file of `slices` slices.
    fn place(&self, page: usize, slices: usize) -> [usize; 3] {
        let (mut rest, mut place) = (page, [0; 3]);
        for axis in self.order {
            let (axis, count) = match axis {
                b'Z' => (0, slices),
                b'C' => (1, self.channels),
                _ => (2, self.times),
            };
            (place[axis], rest) = (rest % count, rest / count);
        }
        // Pages after the last image don't belong to any image.
        if rest > 0 { [usize::MAX; 3] } else { place }
    }
}

/// Parses a file.
pub(super) fn parse(source: &Source<'_>, bytes: &[u8]) -> Result<Volume, ParametrizeError> {
    let broken = |error: tiff::TiffError| source.wrong("a TIFF stack", error.to_string());
    // Upper bound on the decoded size, derived from Deflate. No other compression method makes labels smaller.
    let most = (bytes.len() as u64).saturating_mul(MOST_EXPANSION);
    let mut limits = Limits::default();
    let page = usize::try_from(most.min(LARGEST_PAGE)).unwrap_or(usize::MAX);
    (limits.decoding_buffer_size, limits.intermediate_buffer_size) = (page, page);
    limits.ifd_value_size = bytes.len().max(1 << 12);
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(broken)?.with_limits(limits);
    let description = description(&mut decoder).map_err(|shape| source.wrong("three dimensions", shape))?;
    let image = source.image(description.channels, description.times)?;
    source.fixed_axes("a TIFF stack")?;
    let several = description.channels.saturating_mul(description.times) > 1;
    // A file of one image may have any number of pages. For a file of several images, one slice is assumed if the
    // number of slices is missing.
    let slices = description.slices.or(several.then_some(1));
    if several && description.elsewhere {
        let found = "an OME-XML description that puts pages in another order or in other files".to_owned();
        return Err(
            source.wrong("an OME-TIFF file with all pages in this file, in the order given by DimensionOrder", found)
        );
    }
    let affine = source.affine(description.voxel_size)?;
    let (width, height) = decoder.dimensions().map_err(broken)?;
    let plane = u64::from(width) * u64::from(height);
    let mut found = Collector::new(source, [width as usize, height as usize, 0]);
    let mut pages = 0;
    source.monitor.begin(Stage::counted("reading", "slices"), slices.unwrap_or(0) as u64);
    for page in 0.. {
        source.monitor.check()?;
        if page > 0 {
            if !decoder.more_images() {
                break;
            }
            decoder.next_image().map_err(broken)?;
        }
        if several && description.place(page, slices.unwrap_or(1).max(1))[1..] != image {
            continue;
        }
        if decoder.dimensions().map_err(broken)? != (width, height) {
            let found = format!("slice {pages} (counted from 0) of a different size");
            return Err(source.wrong("slices of equal size", found));
        }
        match decoder.colortype().map_err(broken)? {
            ColorType::Gray(_) => {}
            other => {
                let found = format!("{other:?} in slice {pages} (counted from 0)");
                return Err(source.wrong("greyscale pages with one number per pixel", found));
            }
        }
        let voxels = (found.len() as u64).saturating_add(plane);
        if voxels > 2 * most {
            return Err(source.wrong(
                "at most as many slices as fit in a file of this size",
                format!("more than {pages} slices in {} bytes; the file may be damaged", bytes.len()),
            ));
        }
        found.check_room(voxels)?;
        append(source, decoder.read_image().map_err(broken)?, &mut found)?;
        pages += 1;
        source.monitor.step(1);
    }
    source.monitor.end();
    let size = [width as usize, height as usize, pages];
    if let Some(slices) = slices.filter(|&slices| slices != pages) {
        let found = format!("{pages} pages but {slices} slices in the description");
        return Err(source.wrong("one page per slice", found));
    }
    let expected = plane * pages as u64;
    if found.len() as u64 != expected {
        return Err(source.wrong("one value per pixel", format!("{} values for {expected} pixels", found.len())));
    }
    found.slices(pages);
    Ok(Volume { size, affine, voxels: found.finish()?, doubt: None })
}

fn append(source: &Source<'_>, page: DecodingResult, found: &mut Collector<'_>) -> Result<(), ParametrizeError> {
    let mut all = |mut values: &mut dyn Iterator<Item = f64>| {
        // `try_for_each` needs an iterator whose type is `Sized`. A `dyn Iterator` isn't `Sized`, but a reference to it
        // is.
        Iterator::try_for_each(&mut values, |value| found.push(value))
    };
    match page {
        DecodingResult::U8(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::U16(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::U32(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::U64(page) => all(&mut page.iter().map(|&x| x as f64)),
        DecodingResult::I8(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::I16(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::I32(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::I64(page) => all(&mut page.iter().map(|&x| x as f64)),
        DecodingResult::F32(page) => all(&mut page.iter().map(|&x| x.into())),
        DecodingResult::F64(page) => all(&mut page.iter().copied()),
        _ => Err(source.wrong("integers, or floats of 32 or 64 bits", "floats of 16 bits".to_owned())),
    }
}

/// Parses the description of the first page. If there is none, returns the description of a file that contains one
/// image. The error is a message about a shape with too many dimensions; see [`shaped::images`].
fn description(decoder: &mut Decoder<Cursor<&[u8]>>) -> Result<Description, String> {
    let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap_or_default();
    if text.contains("<OME") {
        return Ok(of_ome(&text).unwrap_or(Description::ONE));
    }
    if text.starts_with("ImageJ=") {
        let mut pitch = |tag| match decoder.find_tag(tag) {
            Ok(Some(tiff::decoder::ifd::Value::Rational(pixels @ 1.., units @ 1..))) => {
                Some(f64::from(units) / f64::from(pixels))
            }
            _ => None,
        };
        let pitches = [pitch(Tag::XResolution), pitch(Tag::YResolution)];
        return Ok(of_imagej(&text, pitches));
    }
    // Files with colours are rejected later, regardless of their shape.
    let is_grey = matches!(decoder.colortype(), Ok(ColorType::Gray(_)));
    let (Ok((width, height)), true) = (decoder.dimensions(), text.starts_with('{') && is_grey) else {
        return Ok(Description::ONE);
    };
    let images = shaped::images(&text, [width as usize, height as usize])?;
    Ok(images.map_or(Description::ONE, |Images { counts: [slices, channels, times], order }| Description {
        slices: Some(slices),
        channels,
        times,
        order,
        ..Description::ONE
    }))
}

fn is(name: &[u8], wanted: &[u8]) -> bool {
    name == wanted
}

/// Parses the first image of an OME-XML description.
fn of_ome(text: &str) -> Option<Description> {
    let mut reader = Reader::from_str(text);
    let pixels = loop {
        match reader.read_event().ok()? {
            Event::Start(tag) | Event::Empty(tag) if is(tag.local_name().as_ref().as_ref(), b"Pixels") => break tag,
            Event::Eof => return None,
            _ => {}
        }
    };
    let get = |name: String| -> Option<String> {
        let mut attributes = pixels.attributes().flatten();
        let found = attributes.find(|attribute| is(attribute.key.as_ref().as_ref(), name.as_bytes()))?;
        Some(found.normalized_value(quick_xml::XmlVersion::Implicit1_0).ok()?.into_owned())
    };
    let count = |axis: char| get(format!("Size{axis}")).and_then(|n| n.parse::<usize>().ok());
    let length = |axis: usize| {
        let name = ["PhysicalSizeX", "PhysicalSizeY", "PhysicalSizeZ"][axis];
        let size = get(name.to_owned()).and_then(|size| size.parse::<f64>().ok()).ok_or(OME_WITHOUT_SIZE[axis])?;
        let unit = get(format!("{name}Unit")).map_or(Some(1.0), |unit| micrometres(&unit));
        unit.map(|unit| size * unit).ok_or(OME_WITHOUT_UNIT[axis])
    };
    let voxel_size = length(0).and_then(|x| Ok([x, length(1)?, length(2)?]));
    let order = get("DimensionOrder".to_owned()).and_then(|order| order.strip_prefix("XY")?.as_bytes().try_into().ok());
    let is_complete = |order: &[u8; 3]| b"ZCT".iter().all(|axis| order.contains(axis));
    let description = Description {
        voxel_size,
        slices: count('Z').map(|slices| slices.max(1)),
        channels: count('C').unwrap_or(1).max(1),
        times: count('T').unwrap_or(1).max(1),
        order: order.filter(is_complete).unwrap_or(*b"ZCT"),
        elsewhere: false,
    };
    let elsewhere = places_differ(&mut reader, &description);
    Some(Description { elsewhere, ..description })
}

/// Returns whether an element `TiffData` places a page at another slice, channel or time than the page's number
/// implies. This is also true if the pages of an image are in several files, since the pages of each file are numbered
/// from the start.
fn places_differ(reader: &mut Reader<&[u8]>, description: &Description) -> bool {
    let slices = description.slices.unwrap_or(1);
    loop {
        match reader.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) if is(tag.local_name().as_ref().as_ref(), b"TiffData") => {
                let number = |name: &[u8]| {
                    let found =
                        tag.attributes().flatten().find(|attribute| is(attribute.key.as_ref().as_ref(), name))?;
                    found.normalized_value(quick_xml::XmlVersion::Implicit1_0).ok()?.parse::<usize>().ok()
                };
                let place = [b"FirstZ", b"FirstC", b"FirstT"].map(|name| number(name).unwrap_or(0));
                if description.place(number(b"IFD").unwrap_or(0), slices) != place {
                    return true;
                }
            }
            Ok(Event::End(tag)) if is(tag.local_name().as_ref().as_ref(), b"Pixels") => return false,
            Ok(Event::Eof) | Err(_) => return false,
            Ok(_) => {}
        }
    }
}

/// Parses ImageJ's description, which consists of lines `key=value`. `pitches` are the width and height of a pixel in
/// ImageJ's unit.
fn of_imagej(text: &str, pitches: [Option<f64>; 2]) -> Description {
    let get = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
    let count = |key: &str| get(key).and_then(|n| n.trim().parse::<usize>().ok());
    let unit = get("unit").and_then(micrometres).ok_or("an ImageJ TIFF file without a known unit of length");
    let spacing =
        get("spacing").and_then(|x| x.trim().parse::<f64>().ok()).ok_or("an ImageJ TIFF file without spacing");
    let pitch = |axis: usize| pitches[axis].ok_or("an ImageJ TIFF file without resolution");
    let voxel_size = unit.and_then(|unit| Ok([pitch(0)? * unit, pitch(1)? * unit, spacing?.abs() * unit]));
    let (channels, times) = (count("channels").unwrap_or(1).max(1), count("frames").unwrap_or(1).max(1));
    let images = count("images").filter(|_| channels == 1 && times == 1);
    Description { voxel_size, slices: count("slices").or(images), channels, times, order: *b"CZT", elsewhere: false }
}

/// Returns the number of micrometres in a unit; `None` for an unknown unit.
pub(super) fn micrometres(unit: &str) -> Option<f64> {
    Some(match unit.trim() {
        "\u{b5}m" | "\u{3bc}m" | "\\u00B5m" | "\\u03BCm" | "um" | "micron" | "microns" => 1.0,
        "micrometer" | "micrometers" | "micrometre" | "micrometres" => 1.0,
        "nm" | "nanometer" | "nanometers" => 1e-3,
        "mm" => 1e3,
        "cm" => 1e4,
        "m" | "meter" | "meters" => 1e6,
        "\u{c5}" => 1e-4,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions_tell_the_size_in_micrometres() {
        let ome = "<?xml version=\"1.0\"?><OME xmlns=\"x\"><Image><Pixels SizeC=\"1\" SizeT=\"1\" SizeZ=\"7\" \
                   PhysicalSizeX=\"200\" PhysicalSizeXUnit=\"nm\" PhysicalSizeY=\"0.2\" PhysicalSizeZ=\"0.6\" \
                   PhysicalSizeZUnit=\"&#181;m\"/></Image></OME>";
        let found = of_ome(ome).unwrap();
        assert_eq!((found.slices, found.channels, found.times), (Some(7), 1, 1));
        assert!(found.voxel_size.unwrap().iter().zip([0.2, 0.2, 0.6]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(of_ome("<OME><Image/></OME>"), None);
        assert_eq!(of_ome("<OME <<<"), None);
        let imagej = "ImageJ=1.53t\nimages=9\nslices=9\nunit=\\u00B5m\nspacing=0.5\nloop=false\n";
        let found = of_imagej(imagej, [Some(0.1), Some(0.1)]);
        assert_eq!(
            found,
            Description { voxel_size: Ok([0.1, 0.1, 0.5]), slices: Some(9), order: *b"CZT", ..Description::ONE }
        );
        let found = of_imagej("ImageJ=1\nimages=6\nchannels=2\nslices=3", [None; 2]);
        assert_eq!((0..7).map(|page| found.place(page, 3)[1]).collect::<Vec<_>>(), [0, 1, 0, 1, 0, 1, usize::MAX]);
        let ome = "<OME><Image><Pixels SizeC='2' SizeT='2' SizeZ='3' DimensionOrder='XYTZC'/></Image></OME>";
        let found = of_ome(ome).unwrap();
        assert_eq!(found.place(7, 3), [0, 1, 1]);
    }

    #[test]
    fn descriptions_tell_what_the_size_lacks() {
        let lacks = |description: Description, what: &str| {
            assert!(description.voxel_size.is_err_and(|format| format.ends_with(what)), "{what}");
        };
        lacks(of_imagej("ImageJ=1\nunit=pixel\nspacing=1", [Some(1.0); 2]), "without a known unit of length");
        lacks(of_imagej("ImageJ=1\nunit=um", [Some(1.0); 2]), "without spacing");
        lacks(of_imagej("ImageJ=1\nunit=um\nspacing=1", [None; 2]), "without resolution");
        let ome = |sizes: &str| of_ome(&format!("<OME><Image><Pixels {sizes}/></Image></OME>")).unwrap();
        lacks(ome("PhysicalSizeX='1' PhysicalSizeY='1'"), "whose OME-XML lacks PhysicalSizeZ");
        lacks(ome("PhysicalSizeX='1' PhysicalSizeXUnit='pixel'"), "whose OME-XML has an unknown PhysicalSizeXUnit");
        lacks(Description::ONE, "without OME-XML or ImageJ's spacing");
    }
}
