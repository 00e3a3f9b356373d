//! Bounds-checked reading of little-endian, big-endian and VAX numbers.

use crate::FormatError;

/// How numbers are stored (the C3D processor types).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Little-endian IEEE (Intel).
    Intel,
    /// Little-endian integers, VAX F floats (DEC).
    Dec,
    /// Big-endian IEEE (SGI/MIPS).
    Mips,
}

/// A view of a file's bytes.
#[derive(Clone, Copy)]
pub struct Bytes<'a> {
    pub all: &'a [u8],
    pub encoding: Encoding,
}

impl<'a> Bytes<'a> {
    pub fn slice(&self, at: usize, length: usize, what: &'static str) -> Result<&'a [u8], FormatError> {
        let needed = at.saturating_add(length);
        self.all.get(at..needed).ok_or(FormatError::Truncated { what, needed, length: self.all.len() })
    }

    fn array<const N: usize>(&self, at: usize, what: &'static str) -> Result<[u8; N], FormatError> {
        let mut out = [0; N];
        out.copy_from_slice(self.slice(at, N, what)?);
        Ok(out)
    }

    pub fn u8(&self, at: usize, what: &'static str) -> Result<u8, FormatError> {
        Ok(self.array::<1>(at, what)?[0])
    }

    pub fn i8(&self, at: usize, what: &'static str) -> Result<i8, FormatError> {
        Ok(self.array::<1>(at, what)?[0].cast_signed())
    }

    pub fn u16(&self, at: usize, what: &'static str) -> Result<u16, FormatError> {
        let raw = self.array::<2>(at, what)?;
        Ok(if self.encoding == Encoding::Mips { u16::from_be_bytes(raw) } else { u16::from_le_bytes(raw) })
    }

    pub fn i16(&self, at: usize, what: &'static str) -> Result<i16, FormatError> {
        Ok(self.u16(at, what)?.cast_signed())
    }

    pub fn f32(&self, at: usize, what: &'static str) -> Result<f32, FormatError> {
        let raw = self.array::<4>(at, what)?;
        Ok(decode_f32(raw, self.encoding))
    }
}

/// One float of four bytes.
pub fn decode_f32(raw: [u8; 4], encoding: Encoding) -> f32 {
    match encoding {
        Encoding::Intel => f32::from_le_bytes(raw),
        Encoding::Mips => f32::from_be_bytes(raw),
        Encoding::Dec => {
            // VAX F: the two 16-bit halves are swapped and the exponent is biased by two more.
            let bits = u32::from_le_bytes([raw[2], raw[3], raw[0], raw[1]]);
            if bits & 0x7f80_0000 == 0 { 0.0 } else { f32::from_bits(bits) / 4.0 }
        }
    }
}
