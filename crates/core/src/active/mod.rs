//! Active markers: LEDs that tell who they are by blinking.

pub mod along;
pub mod codes;
pub mod decode;
mod driving;
mod heard;
pub mod levels;
mod pairs;
