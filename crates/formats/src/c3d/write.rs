//! Writing C3D: Intel encoding, counts and pointers renewed, everything else as it is.

use super::{C3d, Content, Record, Storage, Values};
use crate::FormatError;

const BLOCK: usize = 512;

/// Writes a C3D file.
pub fn write(file: &C3d) -> Result<Vec<u8>, FormatError> {
    let mut file = file.clone();
    renew_frame_counts(&mut file);
    let mut data = Vec::new();
    write_data(&file, &mut data);
    fill_block(&mut data);
    // Pointers depend on the length of the section that holds them: their own width does not change.
    let data_block = 1 + parameter_section(&file.records)?.len() / BLOCK + 1;
    point_to(&mut file, "POINT", data_block);
    if !file.rotations.is_empty() {
        point_to(&mut file, "ROTATION", data_block + data.len() / BLOCK);
        data.extend(file.rotations.iter().flat_map(|v| v.to_le_bytes()));
        fill_block(&mut data);
    }
    let mut out = header(&file, data_block);
    out.extend(parameter_section(&file.records)?);
    out.extend(data);
    Ok(out)
}

fn fill_block(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, 0);
}

/// Renews a group's pointer to its data, where it has one.
fn point_to(file: &mut C3d, group: &str, block: usize) {
    if file.parameter(group, "DATA_START").is_some() {
        let values = Values::Int(vec![(block as u16).cast_signed()]);
        file.set_parameter(group, "DATA_START", Content { dimensions: Vec::new(), values });
    }
}

fn renew_frame_counts(file: &mut C3d) {
    let last = file.first_frame as usize + file.n_frames.max(1) - 1;
    let words = |v: usize| Values::Int(vec![(v as u16).cast_signed(), ((v >> 16) as u16).cast_signed()]);
    let has_fields = file.parameter("TRIAL", "ACTUAL_START_FIELD").is_some();
    if last > 65_535 || has_fields {
        for (name, frame) in [("ACTUAL_START_FIELD", file.first_frame as usize), ("ACTUAL_END_FIELD", last)] {
            let known = file.parameter("TRIAL", name).filter(|c| c.values.len() == 2);
            let dimensions = known.map_or_else(|| vec![2], |c| c.dimensions.clone());
            file.set_parameter("TRIAL", name, Content { dimensions, values: words(frame) });
        }
    }
    if let Some(Content { values, dimensions }) = file.parameter("POINT", "FRAMES").cloned() {
        let values = match values {
            Values::Float(_) => Values::Float(vec![file.n_frames as f32]),
            _ => Values::Int(vec![(file.n_frames.min(65_535) as u16).cast_signed()]),
        };
        file.set_parameter("POINT", "FRAMES", Content { dimensions, values });
    }
}

fn header(file: &C3d, data_block: usize) -> Vec<u8> {
    let mut words = file.header.clone();
    words.resize(256, 0);
    let mut float = |at: usize, value: f32| {
        words[at] = value.to_bits() as u16;
        words[at + 1] = (value.to_bits() >> 16) as u16;
    };
    float(6, file.scale());
    float(10, file.rate_hz);
    words[0] = 0x5002; // parameters in block 2, key 0x50
    words[1] = file.n_points.min(65_535) as u16;
    words[2] = file.analog_per_frame as u16;
    words[3] = file.first_frame.min(65_535) as u16;
    words[4] = (file.first_frame as usize + file.n_frames.max(1) - 1).min(65_535) as u16;
    words[8] = data_block as u16;
    words.iter().flat_map(|w| w.to_le_bytes()).collect()
}

fn parameter_section(records: &[Record]) -> Result<Vec<u8>, FormatError> {
    let mut out = vec![1, 0x50, 0, 84];
    let last = records.len().saturating_sub(1);
    for (i, record) in records.iter().enumerate() {
        write_record(record, i == last, &mut out)?;
    }
    out.extend([0, 0]);
    let blocks = out.len().div_ceil(BLOCK);
    out.resize(blocks * BLOCK, 0);
    // The count of blocks has one byte; longer sections are found by their records' own lengths.
    out[2] = blocks.min(255) as u8;
    Ok(out)
}

fn write_record(record: &Record, is_last: bool, out: &mut Vec<u8>) -> Result<(), FormatError> {
    let too_long =
        |what: &'static str, at: usize| FormatError::Invalid { what, at, why: "too long to be stored".into() };
    let length = i8::try_from(record.name.len()).map_err(|_| too_long("a parameter's name", out.len()))?;
    let group = if record.content.is_some() { record.group } else { -record.group };
    out.push(if record.locked { -length } else { length }.cast_unsigned());
    out.push(group.cast_unsigned());
    out.extend(&record.name);
    let pointer_at = out.len();
    out.extend([0, 0]);
    if let Some(content) = &record.content {
        write_content(content, out);
    }
    let description = u8::try_from(record.description.len()).map_err(|_| too_long("a description", out.len()))?;
    out.push(description);
    out.extend(&record.description);
    if !is_last {
        let next = u16::try_from(out.len() - pointer_at).map_err(|_| too_long("a parameter", pointer_at))?;
        out[pointer_at..pointer_at + 2].copy_from_slice(&next.to_le_bytes());
    }
    Ok(())
}

fn write_content(content: &Content, out: &mut Vec<u8>) {
    let kind: i8 = match content.values {
        Values::Text(_) => -1,
        Values::Byte(_) => 1,
        Values::Int(_) => 2,
        Values::Float(_) => 4,
    };
    out.push(kind.cast_unsigned());
    out.push(content.dimensions.len() as u8);
    out.extend(&content.dimensions);
    match &content.values {
        Values::Text(v) | Values::Byte(v) => out.extend(v),
        Values::Int(v) => out.extend(v.iter().flat_map(|x| x.to_le_bytes())),
        Values::Float(v) => out.extend(v.iter().flat_map(|x| x.to_le_bytes())),
    }
}

fn write_data(file: &C3d, out: &mut Vec<u8>) {
    let mut number = |value: f32| match file.storage {
        Storage::Float => out.extend(value.to_le_bytes()),
        Storage::Integer => out.extend((value as i16).to_le_bytes()),
    };
    for frame in 0..file.n_frames {
        let points = &file.points[frame * file.n_points..(frame + 1) * file.n_points];
        points.iter().flatten().for_each(|&v| number(v));
        let analog = &file.analog[frame * file.analog_per_frame..(frame + 1) * file.analog_per_frame];
        analog.iter().for_each(|&v| number(v));
    }
}
