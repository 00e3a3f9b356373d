//! Vicon `.x2d`: the raw 2D centroids and grey blobs of a Nexus capture (format 3; layout found by inspection).
//!
//! Little-endian blocks of `u16 tag, i32 bytes, i32 count, data`. A frame (tag 0xFFFF) holds camera blocks (0xCCCC),
//! whose stored sizes are 4 bytes short and are not used; each camera holds five inner blocks. A centroid is 11 bytes:
//! x, y, radius as 24-bit fixed point and quality as 16-bit fixed point; the scales stand in the file's header.

use crate::FormatError;
use crate::bytes::{Bytes, Encoding};

/// One centroid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Centroid {
    /// Frame, from 0.
    pub frame: u32,
    /// Camera's device id.
    pub camera: u32,
    /// Pixel.
    pub x: f64,
    /// Pixel.
    pub y: f64,
    /// Radius (px).
    pub radius: f64,
    /// 0–1.
    pub quality: f64,
}

/// The content of a `.x2d`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct X2d {
    /// Number of frames.
    pub frames: u32,
    /// Device ids in the order of the file.
    pub cameras: Vec<u32>,
    /// All centroids, frame by frame.
    pub centroids: Vec<Centroid>,
    /// Number of grey blobs (dots the camera could not fit).
    pub grey_blobs: usize,
    /// Those of them whose pixels could be read.
    pub patches: Vec<Patch>,
}

/// The bright pixels of a dot that the camera could not fit: half hidden, or several that have run together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Patch {
    /// Frame, counted from 0.
    pub frame: u32,
    /// Device id of the camera.
    pub camera: u32,
    /// Column, row and value of each pixel.
    pub pixels: Vec<(u16, u16, u8)>,
}

const TAG_FRAMES: u16 = 0x00fc;
const TAG_TABLE: u16 = 0x00df;
const TAG_DATA_START: u16 = 0x00d0;
const TAG_SYSTEM: u16 = 0x0000;
const CENTROIDS: u16 = 0xdfaa;
const GREY_BLOBS: u16 = 0xdfbb;
const FRAME: u16 = 0xffff;
const CAMERA: u16 = 0xcccc;
const CAMERA_ID: u16 = 0xaa02;
const CENTROID_BYTES: usize = 11;
const INNER_BLOCKS: usize = 5;

/// Reads a `.x2d` file of format 3.
pub fn read(all: &[u8]) -> Result<X2d, FormatError> {
    let bytes = Bytes { all, encoding: Encoding::Intel };
    let version = u32_at(&bytes, 0, "the version")?;
    if version != 3 {
        return Err(FormatError::NotThis { format: "Vicon x2d", why: format!("format {version}, known is 3") });
    }
    let header = Header::read(&bytes)?;
    let mut file = X2d { frames: 0, cameras: header.cameras.clone(), ..X2d::default() };
    let mut at = header.data_start;
    // What follows the last frame is an index of the frames' places, which is not needed.
    for _ in 0..header.frames {
        at = read_frame(&bytes, at, &header, &mut file)?;
        file.frames += 1;
    }
    Ok(file)
}

struct Header {
    frames: u32,
    data_start: usize,
    /// Pixels per unit of x, y, radius and quality.
    scales: [f64; 4],
    cameras: Vec<u32>,
}

fn u32_at(bytes: &Bytes, at: usize, what: &'static str) -> Result<u32, FormatError> {
    Ok(u32::from(bytes.u16(at, what)?) | (u32::from(bytes.u16(at + 2, what)?) << 16))
}

impl Header {
    fn read(bytes: &Bytes) -> Result<Self, FormatError> {
        let mut header = Self { frames: 0, data_start: 0, scales: [0.0; 4], cameras: Vec::new() };
        let mut at = 4;
        // The last block of the header (the system) ends where the data start.
        while header.data_start == 0 || at < header.data_start {
            let tag = bytes.u16(at, "a header block")?;
            let length = u32_at(bytes, at + 2, "a header block")? as usize;
            let body = at + 6;
            bytes.slice(body, length, "a header block")?;
            match tag {
                TAG_FRAMES => header.frames = u32_at(bytes, body, "the number of frames")?,
                TAG_DATA_START => header.data_start = u32_at(bytes, body, "the start of the data")? as usize,
                TAG_TABLE if bytes.u16(body, "a table")? == CENTROIDS => header.read_scales(bytes, body)?,
                TAG_SYSTEM => header.cameras = read_cameras(bytes, body)?,
                _ => {}
            }
            at = body + length;
        }
        if header.scales.iter().any(|s| !s.is_finite() || *s <= 0.0) {
            let why = "no scales for centroids in the header".into();
            return Err(FormatError::NotThis { format: "Vicon x2d", why });
        }
        Ok(header)
    }

    fn read_scales(&mut self, bytes: &Bytes, body: usize) -> Result<(), FormatError> {
        let mut at = body + 6;
        for scale in &mut self.scales {
            *scale = f64::from(bytes.f32(at + 10, "a centroid's scale")?);
            at += 10 + u32_at(bytes, at + 6, "a centroid's scale")? as usize;
        }
        Ok(())
    }
}

/// Device ids: a description of the fields (tag, size or −1 for a text that holds its own length), then the records.
fn read_cameras(bytes: &Bytes, system: usize) -> Result<Vec<u32>, FormatError> {
    let (outer, at) = read_fields(bytes, system)?;
    // The system's own fields: fixed ones first, then the cameras as the last, variable one.
    let fixed: usize = outer.iter().filter(|(_, size)| *size != u32::MAX).map(|(_, size)| *size as usize).sum();
    let table = at + fixed + 4;
    let (fields, mut at) = read_fields(bytes, table)?;
    let count = u32_at(bytes, at, "the number of cameras")?;
    if !fields.iter().any(|&(tag, _)| tag == CAMERA_ID) {
        return Err(FormatError::Invalid { what: "the cameras", at: table, why: "they have no device id".into() });
    }
    at += 4;
    let mut ids = Vec::new();
    for _ in 0..count {
        for &(tag, size) in &fields {
            let length = if size == u32::MAX { u32_at(bytes, at, "a camera's text")? } else { size };
            if tag == CAMERA_ID {
                ids.push(u32_at(bytes, at, "a camera's id")?);
            }
            bytes.slice(at, length as usize, "a camera's record")?;
            at += (length as usize).max(1);
        }
    }
    Ok(ids)
}

fn read_fields(bytes: &Bytes, at: usize) -> Result<(Vec<(u16, u32)>, usize), FormatError> {
    let count = u32_at(bytes, at + 2, "a description of fields")?.min(256);
    let mut fields = Vec::new();
    for i in 0..count as usize {
        let field = at + 6 + 10 * i;
        fields.push((bytes.u16(field, "a field")?, u32_at(bytes, field + 2, "a field")?));
    }
    Ok((fields, at + 6 + 10 * count as usize))
}

fn expect(bytes: &Bytes, at: usize, tag: u16, what: &'static str) -> Result<(), FormatError> {
    let found = bytes.u16(at, what)?;
    if found == tag {
        return Ok(());
    }
    Err(FormatError::Invalid { what, at, why: format!("tag {found:#06x} where {tag:#06x} is expected") })
}

fn read_frame(bytes: &Bytes, at: usize, header: &Header, file: &mut X2d) -> Result<usize, FormatError> {
    expect(bytes, at, FRAME, "a frame")?;
    let mut at = at + 10;
    for &camera in &header.cameras {
        expect(bytes, at, CAMERA, "a camera's block")?;
        at += 10;
        for _ in 0..INNER_BLOCKS {
            let tag = bytes.u16(at, "a block")?;
            let length = u32_at(bytes, at + 2, "a block")? as usize;
            let count = u32_at(bytes, at + 6, "a block")? as usize;
            let body = at + 10;
            bytes.slice(body, length, "a block")?;
            match tag {
                CENTROIDS => read_centroids(bytes, body, length, count, camera, header, file)?,
                GREY_BLOBS => {
                    file.grey_blobs += count;
                    let block = bytes.slice(body, length, "a block of grey blobs")?;
                    file.patches.extend(read_patches(block, count, file.frames, camera));
                }
                _ => {}
            }
            at = body + length;
        }
    }
    Ok(at)
}

fn read_centroids(
    bytes: &Bytes,
    body: usize,
    length: usize,
    count: usize,
    camera: u32,
    header: &Header,
    file: &mut X2d,
) -> Result<(), FormatError> {
    if count.checked_mul(CENTROID_BYTES) != Some(length) {
        let why = format!("{count} centroids in {length} bytes");
        return Err(FormatError::Invalid { what: "a block of centroids", at: body, why });
    }
    for raw in bytes.slice(body, length, "a centroid")?.chunks_exact(CENTROID_BYTES) {
        let u24 = |i: usize| f64::from(u32::from_le_bytes([raw[i], raw[i + 1], raw[i + 2], 0]));
        file.centroids.push(Centroid {
            frame: file.frames,
            camera,
            x: u24(0) * header.scales[0],
            y: u24(3) * header.scales[1],
            radius: u24(6) * header.scales[2],
            quality: f64::from(u16::from_le_bytes([raw[9], raw[10]])) * header.scales[3],
        });
    }
    Ok(())
}

/// Grey blobs of a block: length, number of lines, lines of x, y, n and n values, four zeros. What does not fit that ends it.
fn read_patches(block: &[u8], count: usize, frame: u32, camera: u32) -> Vec<Patch> {
    let u16_at = |at: usize| block.get(at..at + 2).map(|b| u16::from_le_bytes([b[0], b[1]]));
    let mut found = Vec::new();
    let mut at = 0;
    for _ in 0..count {
        let Some(lines) = u16_at(at + 4) else { break };
        at += 6;
        let mut pixels = Vec::new();
        for _ in 0..lines {
            let (Some(x), Some(y), Some(n)) = (u16_at(at), u16_at(at + 2), u16_at(at + 4)) else { return found };
            let Some(values) = block.get(at + 6..at + 6 + usize::from(n)) else { return found };
            pixels.extend(values.iter().enumerate().map(|(k, value)| (x.saturating_add(k as u16), y, *value)));
            at += 6 + usize::from(n);
        }
        at += 4;
        found.push(Patch { frame, camera, pixels });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn block(tag: u16, body: &[u8]) -> Vec<u8> {
        let mut out = tag.to_le_bytes().to_vec();
        out.extend((body.len() as u32).to_le_bytes());
        out.extend(body);
        out
    }

    fn field(tag: u16, size: u32, data: &[u8]) -> Vec<u8> {
        let mut out = tag.to_le_bytes().to_vec();
        out.extend(size.to_le_bytes());
        out.extend((data.len() as u32).to_le_bytes());
        out.extend(data);
        out
    }

    /// A file of one camera (id 77) and the given centroids in its only frame.
    fn example(centroids: &[[u32; 4]]) -> Vec<u8> {
        let mut scales = CENTROIDS.to_le_bytes().to_vec();
        scales.extend(4u32.to_le_bytes());
        for (i, scale) in [1.0f32 / 4096.0, 1.0 / 4096.0, 1.0 / 8192.0, 1.0 / 65536.0].iter().enumerate() {
            scales.extend(field(0xaa00 + i as u16, 3, &scale.to_le_bytes()));
        }
        let mut system = 0xcfab_u16.to_le_bytes().to_vec();
        system.extend(2u32.to_le_bytes());
        system.extend(field(0xaa05, 8, &[]));
        system.extend(field(0xaa06, u32::MAX, &[]));
        system.extend(100f64.to_le_bytes());
        system.extend(0u32.to_le_bytes());
        system.extend(0xcfaa_u16.to_le_bytes());
        system.extend(2u32.to_le_bytes());
        system.extend(field(0xaa02, 4, &[]));
        system.extend(field(0xaa08, u32::MAX, &[]));
        system.extend(1u32.to_le_bytes());
        system.extend(77u32.to_le_bytes());
        system.extend(6u32.to_le_bytes());
        system.extend(b"ab");
        let mut file = 3u32.to_le_bytes().to_vec();
        file.extend(block(TAG_FRAMES, &1u32.to_le_bytes()));
        file.extend(block(TAG_TABLE, &scales));
        let start = file.len() + 14 + 6 + system.len();
        file.extend(block(TAG_DATA_START, &(start as u64).to_le_bytes()));
        file.extend(block(TAG_SYSTEM, &system));
        let counted = |tag: u16, count: usize, body: &[u8]| {
            let mut out = tag.to_le_bytes().to_vec();
            out.extend((body.len() as u32).to_le_bytes());
            out.extend((count as u32).to_le_bytes());
            out.extend(body);
            out
        };
        let body: Vec<u8> = centroids
            .iter()
            .flat_map(|c| {
                let mut raw = Vec::new();
                c[..3].iter().for_each(|v| raw.extend(&v.to_le_bytes()[..3]));
                raw.extend((c[3] as u16).to_le_bytes());
                raw
            })
            .collect();
        file.extend(counted(FRAME, 0, &[]));
        file.extend(counted(CAMERA, 0, &[]));
        file.extend(counted(CENTROIDS, centroids.len(), &body));
        for tag in [0xdfd0, GREY_BLOBS, 0xdfee, 0xdfcc] {
            file.extend(counted(tag, 0, &[]));
        }
        file
    }

    #[test]
    fn centroids_are_scaled_fixed_point() {
        let file = read(&example(&[[4096 * 10 + 2048, 4096 * 7, 8192 * 3, 32768]])).unwrap();
        assert_eq!((file.frames, file.cameras.as_slice()), (1, [77].as_slice()));
        let expected = Centroid { frame: 0, camera: 77, x: 10.5, y: 7.0, radius: 3.0, quality: 0.5 };
        assert_eq!(file.centroids, [expected]);
    }

    #[test]
    fn grey_blobs_are_lines_of_pixels() {
        let mut block = 21_i32.to_le_bytes().to_vec();
        block.extend(2_u16.to_le_bytes());
        for (x, y, values) in [(10_u16, 20_u16, &[60_u8, 70][..]), (9, 21, &[80][..])] {
            block.extend(x.to_le_bytes());
            block.extend(y.to_le_bytes());
            block.extend((values.len() as u16).to_le_bytes());
            block.extend(values);
        }
        block.extend([0; 4]);
        let found = read_patches(&block, 1, 3, 77);
        assert_eq!(found, [Patch { frame: 3, camera: 77, pixels: vec![(10, 20, 60), (11, 20, 70), (9, 21, 80)] }]);
        assert!(read_patches(&block[..12], 1, 3, 77).is_empty());
    }

    proptest! {
        #[test]
        fn mutated_bytes_never_panic(at in 0usize..400, value: u8, cut in 1usize..500) {
            let mut bytes = example(&[[1, 2, 3, 4], [5, 6, 7, 8]]);
            let at = at % bytes.len();
            bytes[at] = value;
            bytes.truncate(cut);
            if let Ok(file) = read(&bytes) {
                prop_assert!(file.centroids.len() * CENTROID_BYTES <= bytes.len());
            }
        }
    }
}
