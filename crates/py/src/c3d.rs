//! C3D for Python: the file as it is, with arrays for points and analog values.

use crate::errors::{BytesError, of_format};
use markerloom_formats::c3d::{self, C3d, Content, Storage, Values};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

type ResidualsAndMasks<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<i32>>);

/// A C3D file in memory.
#[pyclass(name = "C3d")]
pub struct PyC3d {
    inner: C3d,
}

#[pymethods]
impl PyC3d {
    /// Reads a file's bytes.
    #[staticmethod]
    fn read(bytes: &[u8]) -> PyResult<Self> {
        c3d::read(bytes).map(|inner| Self { inner }).map_err(|e| of_format(&e))
    }

    /// A new file without points.
    #[staticmethod]
    fn empty(rate_hz: f32, first_frame: u32) -> Self {
        let inner = C3d {
            header: vec![0; 256],
            records: Vec::new(),
            storage: Storage::Float,
            first_frame,
            rate_hz,
            n_points: 0,
            n_frames: 0,
            points: Vec::new(),
            analog_per_frame: 0,
            analog: Vec::new(),
            rotations: Vec::new(),
            warnings: Vec::new(),
        };
        Self { inner }
    }

    /// The file's bytes.
    fn write<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        c3d::write(&self.inner).map(|bytes| PyBytes::new(py, &bytes)).map_err(|e| of_format(&e))
    }

    #[getter]
    fn rate_hz(&self) -> f32 {
        self.inner.rate_hz
    }

    #[getter]
    fn first_frame(&self) -> u32 {
        self.inner.first_frame
    }

    #[getter]
    fn n_frames(&self) -> usize {
        self.inner.n_frames
    }

    #[getter]
    fn is_float(&self) -> bool {
        self.inner.storage == Storage::Float
    }

    #[getter]
    fn scale(&self) -> f32 {
        self.inner.scale()
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.inner.warnings.clone()
    }

    /// Header words as stored.
    #[getter]
    fn header(&self) -> Vec<u16> {
        self.inner.header.clone()
    }

    /// Coordinates in the file's unit (`n_frames`, `n_points`, 3), absent samples as stored.
    fn coordinates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let factor = f64::from(self.inner.point_factor());
        let values: Vec<f64> =
            self.inner.points.iter().flat_map(|p| [p[0], p[1], p[2]].map(|v| f64::from(v) * factor)).collect();
        values.into_pyarray(py).reshape([self.inner.n_frames, self.inner.n_points, 3])
    }

    /// Residual (file's unit; negative = absent) and camera mask of each sample (`n_frames`, `n_points`).
    fn residuals<'py>(&self, py: Python<'py>) -> PyResult<ResidualsAndMasks<'py>> {
        let scale = f64::from(self.inner.scale().abs());
        let shape = [self.inner.n_frames, self.inner.n_points];
        let words: Vec<i32> = self.inner.points.iter().map(|p| (p[3] as i32).clamp(-32_768, 32_767)).collect();
        let residual: Vec<f64> =
            words.iter().map(|&w| if w < 0 { -1.0 } else { f64::from(w & 0xff) * scale }).collect();
        let mask: Vec<i32> = words.iter().map(|&w| if w < 0 { 0 } else { (w >> 8) & 0x7f }).collect();
        Ok((residual.into_pyarray(py).reshape(shape)?, mask.into_pyarray(py).reshape(shape)?))
    }

    /// Raw analog values (`n_frames`, values per frame).
    fn analog<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.inner.analog.clone().into_pyarray(py).reshape([self.inner.n_frames, self.inner.analog_per_frame])
    }

    /// Rotations (`n_frames`, per frame, 17): 4×4 matrices, column by column, and a reliability.
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let frames = self.inner.n_frames.max(1);
        let per_frame = self.inner.rotations.len() / 17 / frames;
        self.inner.rotations.clone().into_pyarray(py).reshape([frames, per_frame, 17])
    }

    /// Replaces all points; `words` are residual words (−1 = absent). The file becomes a float file.
    fn set_points(&mut self, coordinates: PyReadonlyArray3<'_, f64>, words: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let (xyz, words) = (coordinates.as_array(), words.as_array());
        let (frames, points) = words.dim();
        if xyz.dim() != (frames, points, 3) {
            return Err(BytesError::new_err("coordinates and residual words differ in shape"));
        }
        if frames != self.inner.n_frames && (self.inner.analog_per_frame > 0 || !self.inner.rotations.is_empty()) {
            return Err(BytesError::new_err(
                "the number of frames cannot change in a file with analog or rotation data",
            ));
        }
        (self.inner.n_frames, self.inner.n_points) = (frames, points);
        self.inner.storage = Storage::Float;
        self.inner.points = (0..frames * points)
            .map(|i| {
                let (f, p) = (i / points, i % points);
                [xyz[(f, p, 0)] as f32, xyz[(f, p, 1)] as f32, xyz[(f, p, 2)] as f32, words[(f, p)] as f32]
            })
            .collect();
        Ok(())
    }

    /// Replaces all rotations (`n_frames`, per frame, 17): 4×4 matrices, column by column, and a reliability.
    fn set_rotations(&mut self, values: PyReadonlyArray3<'_, f64>) -> PyResult<()> {
        let values = values.as_array();
        if values.dim().0 != self.inner.n_frames || values.dim().2 != 17 {
            return Err(BytesError::new_err("rotations have 17 numbers for each segment in each frame of the file"));
        }
        self.inner.rotations = values.iter().map(|&v| v as f32).collect();
        Ok(())
    }

    /// The strings of NAME, NAME2, … of a group.
    fn strings(&self, group: &str, name: &str) -> Vec<String> {
        self.inner.long_strings(group, name)
    }

    /// First number of a parameter.
    fn number(&self, group: &str, name: &str) -> Option<f64> {
        self.inner.number(group, name)
    }

    /// All numbers of a parameter.
    fn numbers(&self, group: &str, name: &str) -> Vec<f64> {
        match self.inner.parameter(group, name).map(|c| &c.values) {
            Some(Values::Int(v)) => v.iter().map(|&x| f64::from(x)).collect(),
            Some(Values::Float(v)) => v.iter().map(|&x| f64::from(x)).collect(),
            Some(Values::Byte(v)) => v.iter().map(|&x| f64::from(x)).collect(),
            _ => Vec::new(),
        }
    }

    /// Groups and parameters in the file's order, as dictionaries.
    fn records<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let list = PyList::empty(py);
        for record in &self.inner.records {
            let one = PyDict::new(py);
            one.set_item("name", String::from_utf8_lossy(&record.name))?;
            one.set_item("group", record.group)?;
            one.set_item("locked", record.locked)?;
            one.set_item("description", String::from_utf8_lossy(&record.description))?;
            if let Some(content) = &record.content {
                one.set_item("dimensions", content.dimensions.iter().map(|&d| u32::from(d)).collect::<Vec<_>>())?;
                match &content.values {
                    Values::Text(v) => one.set_item("values", PyBytes::new(py, v))?,
                    Values::Byte(v) => one.set_item("values", v.iter().map(|&b| u32::from(b)).collect::<Vec<_>>())?,
                    Values::Int(v) => one.set_item("values", v.clone())?,
                    Values::Float(v) => one.set_item("values", v.clone())?,
                }
            }
            list.append(one)?;
        }
        Ok(list)
    }

    /// Sets a list of strings; lists longer than 255 continue in NAME2, NAME3, ….
    fn set_strings(&mut self, group: &str, name: &str, strings: Vec<String>) {
        let parts: Vec<&[String]> = if strings.is_empty() { vec![&[]] } else { strings.chunks(255).collect() };
        for (i, part) in parts.into_iter().enumerate() {
            let width = part.iter().map(String::len).max().unwrap_or(0).clamp(1, 255);
            let mut bytes = Vec::with_capacity(width * part.len());
            for text in part {
                let kept = &text.as_bytes()[..text.len().min(width)];
                bytes.extend(kept);
                bytes.extend(std::iter::repeat_n(b' ', width - kept.len()));
            }
            let content = Content { dimensions: vec![width as u8, part.len() as u8], values: Values::Text(bytes) };
            let name = if i == 0 { name.to_string() } else { format!("{name}{}", i + 1) };
            self.inner.set_parameter(group, &name, content);
        }
    }

    /// Sets a text.
    fn set_text(&mut self, group: &str, name: &str, text: &str) {
        let bytes: Vec<u8> = text.bytes().take(255).collect();
        self.inner.set_parameter(
            group,
            name,
            Content { dimensions: vec![bytes.len() as u8], values: Values::Text(bytes) },
        );
    }

    /// Sets a scalar (no dimensions) or an array of 16-bit integers.
    #[pyo3(signature = (group, name, values, dimensions=None))]
    fn set_ints(&mut self, group: &str, name: &str, values: Vec<i64>, dimensions: Option<Vec<u8>>) -> PyResult<()> {
        let dimensions = checked(dimensions, values.len())?;
        let values = Values::Int(values.into_iter().map(|v| (v as u16).cast_signed()).collect());
        self.inner.set_parameter(group, name, Content { dimensions, values });
        Ok(())
    }

    /// Sets a scalar (no dimensions) or an array of floats.
    #[pyo3(signature = (group, name, values, dimensions=None))]
    fn set_floats(&mut self, group: &str, name: &str, values: Vec<f32>, dimensions: Option<Vec<u8>>) -> PyResult<()> {
        let dimensions = checked(dimensions, values.len())?;
        self.inner.set_parameter(group, name, Content { dimensions, values: Values::Float(values) });
        Ok(())
    }

    /// Sets bytes with dimensions.
    fn set_bytes(&mut self, group: &str, name: &str, values: &[u8], dimensions: Vec<u8>) -> PyResult<()> {
        let dimensions = checked(Some(dimensions), values.len())?;
        self.inner.set_parameter(group, name, Content { dimensions, values: Values::Byte(values.to_vec()) });
        Ok(())
    }
}

fn checked(dimensions: Option<Vec<u8>>, count: usize) -> PyResult<Vec<u8>> {
    let dimensions = dimensions.unwrap_or_default();
    let product: usize = dimensions.iter().map(|&d| usize::from(d)).product();
    if product == count {
        Ok(dimensions)
    } else {
        Err(BytesError::new_err("dimensions do not fit the number of values"))
    }
}
