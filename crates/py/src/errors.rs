//! One base exception and one named subclass per cause.

use markerloom_core::reconstruct::ReconstructError;
use markerloom_core::triangulate::NoPoint;
use markerloom_formats::FormatError;
use pyo3::prelude::*;
use pyo3::{PyErr, create_exception};

create_exception!(markerloom._core, MarkerloomError, pyo3::exceptions::PyException);
create_exception!(markerloom._core, BytesError, MarkerloomError);
create_exception!(markerloom._core, RigError, MarkerloomError);
create_exception!(markerloom._core, InputError, MarkerloomError);
create_exception!(markerloom._core, NoPointError, MarkerloomError);

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("MarkerloomError", py.get_type::<MarkerloomError>())?;
    module.add("BytesError", py.get_type::<BytesError>())?;
    module.add("InputError", py.get_type::<InputError>())?;
    module.add("RigError", py.get_type::<RigError>())?;
    module.add("NoPointError", py.get_type::<NoPointError>())
}

pub fn of_format(error: &FormatError) -> PyErr {
    BytesError::new_err(error.to_string())
}

pub fn of_reconstruct(error: &ReconstructError) -> PyErr {
    RigError::new_err(error.to_string())
}

/// The reason's name comes first, so that scripts can tell the reasons apart.
pub fn of_no_point(reason: &NoPoint) -> PyErr {
    let name = match reason {
        NoPoint::TooFewRays(_) => "too_few_rays",
        NoPoint::Parallel { .. } => "parallel",
        NoPoint::BehindCamera(_) => "behind_camera",
        NoPoint::Outlier { .. } => "outlier",
    };
    NoPointError::new_err((name, reason.to_string()))
}
