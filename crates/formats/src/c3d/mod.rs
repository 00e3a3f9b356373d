//! C3D, read and written without loss (after "The C3D File Format User Guide", Motion Lab Systems 2008).
//!
//! A file is a header of 512 bytes, a parameter section (groups and parameters in any order) and a data section of
//! points and analog samples. Everything is kept as it stands in the file: order, descriptions, locks, raw residual
//! words, raw analog values. Numbers stored in DEC or SGI encoding are converted; files are always written in Intel
//! encoding, integer files as integers unless their points were replaced.

mod read;
mod write;

pub use read::read;
pub use write::write;

/// A parameter's values, in the file's (column-major) order.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Characters; the first dimension is the length of each string.
    Text(Vec<u8>),
    /// Bytes.
    Byte(Vec<u8>),
    /// 16-bit integers, signed or not as the reader takes them.
    Int(Vec<i16>),
    /// Floats.
    Float(Vec<f32>),
}

impl Values {
    /// Number of elements.
    pub fn len(&self) -> usize {
        match self {
            Self::Text(v) | Self::Byte(v) => v.len(),
            Self::Int(v) => v.len(),
            Self::Float(v) => v.len(),
        }
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A group or a parameter of the parameter section.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Name as stored.
    pub name: Vec<u8>,
    /// Number of the group it is or belongs to (1–127).
    pub group: i8,
    /// Whether it is marked as locked.
    pub locked: bool,
    /// Description as stored.
    pub description: Vec<u8>,
    /// What a parameter holds; `None` for a group.
    pub content: Option<Content>,
}

/// Dimensions and values of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Content {
    /// Dimensions, fastest first; empty for a scalar.
    pub dimensions: Vec<u8>,
    /// The values.
    pub values: Values,
}

/// How the data section stores numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// 16-bit integers.
    Integer,
    /// 32-bit floats.
    Float,
}

/// A C3D file in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct C3d {
    /// The header's 256 words as stored, byte order converted; counts and places are renewed when writing.
    pub header: Vec<u16>,
    /// Groups and parameters in the order of the file.
    pub records: Vec<Record>,
    /// How the data section stores numbers.
    pub storage: Storage,
    /// First frame's number.
    pub first_frame: u32,
    /// Frames per second.
    pub rate_hz: f32,
    /// Points per frame.
    pub n_points: usize,
    /// Frames.
    pub n_frames: usize,
    /// Per frame and point: x, y, z and the residual word. In integer files the integers.
    pub points: Vec<[f32; 4]>,
    /// Analog values per frame (channels × samples per frame).
    pub analog_per_frame: usize,
    /// Raw analog values, frame by frame.
    pub analog: Vec<f32>,
    /// Rotation matrices of an extension (C-Motion; written by Theia and Qualisys): per frame and segment 16 numbers and
    /// a reliability, in a data section of their own that ROTATION:DATA_START points to.
    pub rotations: Vec<f32>,
    /// What was odd about the file but did not prevent reading it.
    pub warnings: Vec<String>,
}

impl C3d {
    /// A parameter by group and name (letters in either case).
    pub fn parameter(&self, group: &str, name: &str) -> Option<&Content> {
        self.find(group, name).and_then(|i| self.records[i].content.as_ref())
    }

    fn find(&self, group: &str, name: &str) -> Option<usize> {
        let same = |stored: &[u8], wanted: &str| stored.eq_ignore_ascii_case(wanted.as_bytes());
        let id = self.records.iter().find(|r| r.content.is_none() && same(&r.name, group))?.group;
        self.records.iter().position(|r| r.group == id && r.content.is_some() && same(&r.name, name))
    }

    /// Sets a parameter, creating group and parameter where they are missing; keeps its place where it exists.
    pub fn set_parameter(&mut self, group: &str, name: &str, content: Content) {
        if let Some(i) = self.find(group, name) {
            self.records[i].content = Some(content);
            return;
        }
        let is_group = |r: &&Record| r.content.is_none() && r.name.eq_ignore_ascii_case(group.as_bytes());
        let existing = self.records.iter().find(is_group).map(|r| r.group);
        let id = existing.unwrap_or_else(|| self.add_group(group));
        let record = Record {
            name: name.as_bytes().to_vec(),
            group: id,
            locked: false,
            description: Vec::new(),
            content: Some(content),
        };
        let after = self.records.iter().rposition(|r| r.group == id).map_or(self.records.len(), |i| i + 1);
        self.records.insert(after, record);
    }

    fn add_group(&mut self, name: &str) -> i8 {
        let taken: Vec<i8> = self.records.iter().map(|r| r.group).collect();
        let id = (1..=127).find(|i| !taken.contains(i)).unwrap_or(127);
        let record =
            Record { name: name.as_bytes().to_vec(), group: id, locked: false, description: Vec::new(), content: None };
        self.records.push(record);
        id
    }

    /// First number of a parameter.
    pub fn number(&self, group: &str, name: &str) -> Option<f64> {
        match &self.parameter(group, name)?.values {
            Values::Int(v) => v.first().map(|&x| f64::from(x)),
            Values::Float(v) => v.first().map(|&x| f64::from(x)),
            Values::Byte(v) => v.first().map(|&x| f64::from(x)),
            Values::Text(_) => None,
        }
    }

    /// The strings of a text parameter, without trailing blanks.
    pub fn strings(&self, group: &str, name: &str) -> Option<Vec<String>> {
        let content = self.parameter(group, name)?;
        let Values::Text(bytes) = &content.values else { return None };
        let length = usize::from(*content.dimensions.first().unwrap_or(&1));
        let clean = |part: &[u8]| String::from_utf8_lossy(part).trim_end_matches(['\0', ' ']).to_string();
        Some(if length == 0 { Vec::new() } else { bytes.chunks(length).map(clean).collect() })
    }

    /// A long list of strings spread over NAME, NAME2, NAME3, … (255 at most in each).
    pub fn long_strings(&self, group: &str, name: &str) -> Vec<String> {
        let mut all = self.strings(group, name).unwrap_or_default();
        for i in 2..=999 {
            match self.strings(group, &format!("{name}{i}")) {
                Some(more) => all.extend(more),
                None => break,
            }
        }
        all
    }

    /// Factor from stored to real coordinates: 1 in float files.
    pub fn point_factor(&self) -> f32 {
        match self.storage {
            Storage::Float => 1.0,
            Storage::Integer => self.scale().abs(),
        }
    }

    /// POINT:SCALE, or the header's if that is missing; negative in float files.
    pub fn scale(&self) -> f32 {
        let header = f32::from_bits(u32::from(self.header[6]) | (u32::from(self.header[7]) << 16));
        self.number("POINT", "SCALE").map_or(header, |s| s as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub fn example(n_frames: usize, n_points: usize, storage: Storage) -> C3d {
        let mut file = C3d {
            header: vec![0; 256],
            records: Vec::new(),
            storage,
            first_frame: 1,
            rate_hz: 120.0,
            n_points,
            n_frames,
            points: (0..n_frames * n_points).map(|i| [i as f32, 2.0, -3.0, 513.0]).collect(),
            analog_per_frame: 2,
            analog: (0..2 * n_frames).map(|i| i as f32).collect(),
            rotations: Vec::new(),
            warnings: Vec::new(),
        };
        let scale = if storage == Storage::Float { -0.02 } else { 0.1 };
        let scalar = |values| Content { dimensions: Vec::new(), values };
        file.set_parameter("POINT", "SCALE", scalar(Values::Float(vec![scale])));
        file.set_parameter("POINT", "USED", scalar(Values::Int(vec![n_points as i16])));
        file.set_parameter("ANALOG", "USED", scalar(Values::Int(vec![2])));
        let labels = Content { dimensions: vec![4, 2], values: Values::Text(b"LASIRASI".to_vec()) };
        file.set_parameter("POINT", "LABELS", labels);
        file
    }

    #[test]
    fn what_is_written_is_read_back_in_both_storages() {
        for storage in [Storage::Integer, Storage::Float] {
            let file = example(7, 3, storage);
            let again = read(&write(&file).unwrap()).unwrap();
            assert_eq!(again.points, file.points);
            assert_eq!(again.analog, file.analog);
            assert_eq!(again.strings("point", "labels").unwrap(), ["LASI", "RASI"]);
            assert_eq!(write(&again).unwrap(), write(&file).unwrap());
        }
    }

    #[test]
    fn more_frames_than_the_header_can_count_survive() {
        let file = example(70_000, 1, Storage::Float);
        let again = read(&write(&file).unwrap()).unwrap();
        assert_eq!(again.n_frames, 70_000);
        assert_eq!(again.points, file.points);
    }

    #[test]
    fn a_hundred_and_fifty_thousand_frames_need_both_trial_words() {
        let mut file = example(150_000, 1, Storage::Integer);
        file.points.iter_mut().for_each(|p| p[0] = 1.0);
        file.analog.iter_mut().for_each(|a| *a = 2.0);
        file.first_frame = 1000;
        let again = read(&write(&file).unwrap()).unwrap();
        assert_eq!((again.n_frames, again.first_frame), (150_000, 1000));
    }

    proptest! {
        #[test]
        fn mutated_bytes_never_panic(at in 0usize..2048, value: u8, cut in 0usize..3000) {
            let mut bytes = write(&example(5, 3, Storage::Float)).unwrap();
            let at = at % bytes.len();
            bytes[at] = value;
            bytes.truncate(cut.max(1));
            if let Ok(file) = read(&bytes) {
                prop_assert!(file.points.len() * 8 <= bytes.len());
                let _ = write(&file);
            }
        }
    }
}
