//! Reading C3D.

use super::{C3d, Content, Record, Storage, Values};
use crate::FormatError;
use crate::bytes::{Bytes, Encoding};

const BLOCK: usize = 512;

/// Reads a C3D file.
pub fn read(all: &[u8]) -> Result<C3d, FormatError> {
    let plain = Bytes { all, encoding: Encoding::Intel };
    if plain.u8(1, "the header's key")? != 0x50 {
        return Err(FormatError::NotThis { format: "C3D", why: "its second byte is not 0x50".into() });
    }
    let mut warnings = Vec::new();
    let parameters_at = parameter_section(&plain, &mut warnings)?;
    let encoding = match plain.u8(parameters_at + 3, "the processor type")? {
        84 | 1 | 0 => Encoding::Intel,
        85 | 2 => Encoding::Dec,
        86 | 3 => Encoding::Mips,
        other => {
            let why = format!("{other} is none of 84 (Intel), 85 (DEC), 86 (SGI)");
            return Err(FormatError::Invalid { what: "the processor type", at: parameters_at + 3, why });
        }
    };
    let bytes = Bytes { all, encoding };
    let header = (0..256).map(|i| bytes.u16(2 * i, "the header")).collect::<Result<Vec<u16>, _>>()?;
    let records = read_records(&bytes, parameters_at + 4, &mut warnings)?;
    let mut file = C3d {
        header: normalised(header, &bytes)?,
        records,
        storage: Storage::Float,
        first_frame: 1,
        rate_hz: bytes.f32(20, "the frame rate")?,
        n_points: 0,
        n_frames: 0,
        points: Vec::new(),
        analog_per_frame: 0,
        analog: Vec::new(),
        rotations: Vec::new(),
        warnings,
    };
    fill_counts(&mut file);
    read_data(&mut file, &bytes)?;
    read_rotations(&mut file, &bytes)?;
    if file.n_points == 0 && file.analog_per_frame == 0 && file.rotations.is_empty() {
        file.n_frames = 0; // a number of frames that no data bear out
    }
    Ok(file)
}

/// Floats in the header become Intel floats, so that a header read from any processor can be written as it is.
fn normalised(mut header: Vec<u16>, bytes: &Bytes) -> Result<Vec<u16>, FormatError> {
    let float_words = [6, 10].into_iter().chain((0..18).map(|event| 152 + 2 * event));
    for word in float_words {
        let bits = bytes.f32(2 * word, "the header")?.to_bits();
        header[word] = bits as u16;
        header[word + 1] = (bits >> 16) as u16;
    }
    // Event labels are characters: their bytes keep their order.
    for (word, value) in header.iter_mut().enumerate().skip(198).take(36) {
        *value = u16::from_le_bytes([bytes.all[2 * word], bytes.all[2 * word + 1]]);
    }
    Ok(header)
}

/// The parameter section's first byte; the header's pointer is wrong in some old files.
fn parameter_section(bytes: &Bytes, warnings: &mut Vec<String>) -> Result<usize, FormatError> {
    let pointed = usize::from(bytes.u8(0, "the parameter pointer")?).saturating_sub(1) * BLOCK;
    let plausible = |at: usize| at >= BLOCK && matches!(bytes.u8(at + 3, "the parameter section"), Ok(84..=86));
    if plausible(pointed) {
        return Ok(pointed);
    }
    if plausible(BLOCK) {
        warnings.push("the header points to no parameter section; the one in block 2 is used".into());
        return Ok(BLOCK);
    }
    let why = format!("no parameter section at block {} or 2", pointed / BLOCK + 1);
    Err(FormatError::Invalid { what: "the parameter pointer", at: 0, why })
}

fn read_records(bytes: &Bytes, start: usize, warnings: &mut Vec<String>) -> Result<Vec<Record>, FormatError> {
    let mut records = Vec::new();
    let mut at = start;
    loop {
        let Ok(name_length) = bytes.i8(at, "a parameter's name") else {
            warnings.push("the parameter section has no end".into());
            break;
        };
        let group = bytes.i8(at + 1, "a parameter's group")?;
        if name_length == 0 || group == 0 {
            break;
        }
        let length = usize::from(name_length.unsigned_abs());
        let name = bytes.slice(at + 2, length, "a parameter's name")?.to_vec();
        let pointer_at = at + 2 + length;
        let next = usize::from(bytes.u16(pointer_at, "a parameter's length")?);
        let (content, description) = if group < 0 {
            (None, read_description(bytes, pointer_at + 2))
        } else {
            let (content, end) = read_content(bytes, pointer_at + 2)?;
            (Some(content), read_description(bytes, end))
        };
        records.push(Record { name, group: group.saturating_abs(), locked: name_length < 0, description, content });
        if next == 0 {
            break;
        }
        at = pointer_at + next;
    }
    Ok(records)
}

fn read_description(bytes: &Bytes, at: usize) -> Vec<u8> {
    let length = usize::from(bytes.u8(at, "a description").unwrap_or(0));
    bytes.slice(at + 1, length, "a description").unwrap_or_default().to_vec()
}

fn read_content(bytes: &Bytes, at: usize) -> Result<(Content, usize), FormatError> {
    let kind = bytes.i8(at, "a parameter's type")?;
    let n_dimensions = usize::from(bytes.u8(at + 1, "a parameter's dimensions")?);
    let dimensions = bytes.slice(at + 2, n_dimensions, "a parameter's dimensions")?.to_vec();
    let mut count = 1usize;
    for &d in &dimensions {
        count = count.saturating_mul(usize::from(d));
    }
    let data = at + 2 + n_dimensions;
    let width = usize::from(kind.unsigned_abs());
    if !matches!(kind, -1 | 1 | 2 | 4) {
        return Err(FormatError::Invalid {
            what: "a parameter's type",
            at,
            why: format!("{kind} is none of -1, 1, 2, 4"),
        });
    }
    let raw = bytes.slice(data, count.saturating_mul(width), "a parameter's values")?;
    let values = match kind {
        -1 => Values::Text(raw.to_vec()),
        1 => Values::Byte(raw.to_vec()),
        2 => Values::Int((0..count).map(|i| bytes.i16(data + 2 * i, "a parameter")).collect::<Result<_, _>>()?),
        _ => Values::Float((0..count).map(|i| bytes.f32(data + 4 * i, "a parameter")).collect::<Result<_, _>>()?),
    };
    Ok((Content { dimensions, values }, data + count * width))
}

/// Counts: parameters win over the header, because the header's 16 bits overflow.
fn fill_counts(file: &mut C3d) {
    let unsigned = |v: f64| if v < 0.0 { v + 65_536.0 } else { v };
    let (first, last) = (u32::from(file.header[3]), u32::from(file.header[4]));
    file.storage = if file.scale() < 0.0 { Storage::Float } else { Storage::Integer };
    file.n_points = file.number("POINT", "USED").map_or(usize::from(file.header[1]), |v| unsigned(v) as usize);
    file.analog_per_frame = usize::from(file.header[2]);
    file.first_frame = first;
    file.n_frames = (last + 1).saturating_sub(first) as usize;
    if let (Some(start), Some(end)) = (long_word(file, "ACTUAL_START_FIELD"), long_word(file, "ACTUAL_END_FIELD"))
        && end >= start
    {
        file.first_frame = start;
        file.n_frames = (end - start + 1) as usize;
    } else if let Some(frames) = file.number("POINT", "LONG_FRAMES").filter(|v| *v >= 1.0) {
        file.n_frames = frames as usize;
    } else if let Some(frames) = file.number("POINT", "FRAMES").map(unsigned)
        && frames as usize > file.n_frames
    {
        // Files of more than 65,535 frames without a TRIAL group keep at least this.
        file.n_frames = frames as usize;
    }
    if let Some(rate) = file.number("POINT", "RATE").filter(|r| *r > 0.0) {
        file.rate_hz = rate as f32;
    }
}

fn long_word(file: &C3d, name: &str) -> Option<u32> {
    match &file.parameter("TRIAL", name)?.values {
        Values::Int(v) if v.len() == 2 => {
            Some(u32::from(v[0].cast_unsigned()) | (u32::from(v[1].cast_unsigned()) << 16))
        }
        Values::Float(v) if v.len() == 1 && v[0] >= 0.0 => Some(v[0] as u32),
        _ => None,
    }
}

fn read_data(file: &mut C3d, bytes: &Bytes) -> Result<(), FormatError> {
    let pointer = file.number("POINT", "DATA_START").filter(|v| *v >= 1.0).unwrap_or_else(|| f64::from(file.header[8]));
    let header_pointer = usize::from(file.header[8]);
    let mut start = (pointer as usize).saturating_sub(1).saturating_mul(BLOCK);
    if start >= bytes.all.len() && header_pointer > 1 {
        start = (header_pointer - 1) * BLOCK;
    }
    let width = if file.storage == Storage::Float { 4 } else { 2 };
    let frame_size = width * (4 * file.n_points + file.analog_per_frame);
    if frame_size == 0 {
        return Ok(());
    }
    let available = bytes.all.len().saturating_sub(start) / frame_size;
    if available == 0 && file.n_frames > 0 {
        let needed = start.saturating_add(frame_size);
        return Err(FormatError::Truncated { what: "the first frame", needed, length: bytes.all.len() });
    }
    if available < file.n_frames {
        file.warnings.push(format!("the file announces {} frames and holds {available}", file.n_frames));
        file.n_frames = available;
    }
    file.points.reserve(file.n_frames * file.n_points);
    file.analog.reserve(file.n_frames * file.analog_per_frame);
    let number = |at: usize| match width {
        4 => bytes.f32(at, "the data"),
        _ => bytes.i16(at, "the data").map(f32::from),
    };
    for frame in 0..file.n_frames {
        let mut at = start + frame * frame_size;
        for _ in 0..file.n_points {
            file.points.push([number(at)?, number(at + width)?, number(at + 2 * width)?, number(at + 3 * width)?]);
            at += 4 * width;
        }
        for i in 0..file.analog_per_frame {
            file.analog.push(number(at + i * width)?);
        }
    }
    Ok(())
}

/// Numbers of one rotation: a 4×4 matrix and its reliability.
const ROTATION_NUMBERS: usize = 17;

fn read_rotations(file: &mut C3d, bytes: &Bytes) -> Result<(), FormatError> {
    let count = |name: &str| file.number("ROTATION", name).filter(|v| *v >= 1.0).map(|v| v as usize);
    let (Some(used), Some(block)) = (count("USED"), count("DATA_START")) else { return Ok(()) };
    let per_frame = used.saturating_mul(count("RATIO").unwrap_or(1)).saturating_mul(ROTATION_NUMBERS);
    let total = per_frame.saturating_mul(file.n_frames);
    let start = (block - 1) * BLOCK;
    bytes.slice(start, total.saturating_mul(4), "the rotations")?;
    file.rotations = (0..total).map(|i| bytes.f32(start + 4 * i, "the rotations")).collect::<Result<_, _>>()?;
    Ok(())
}
