//! Active markers: LEDs that tell who they are by blinking.

pub mod codes;
pub mod decode;
