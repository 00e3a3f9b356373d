//! Image regions that a camera is told to ignore (lamps, other cameras' strobes).

use nalgebra::Vector2;

/// A grid of tiles over the image; a set tile is ignored.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mask {
    /// Tile width and height in pixels; zero for "no mask".
    pub tile_px: [f64; 2],
    /// Number of tile columns and rows.
    pub grid: [usize; 2],
    /// Row-major; `true` = ignored.
    pub tiles: Vec<bool>,
}

impl Mask {
    /// Whether a pixel lies in an ignored tile. Pixels outside the grid are not ignored.
    pub fn covers(&self, pixel: Vector2<f64>) -> bool {
        if self.tiles.is_empty() {
            return false;
        }
        let column = ((pixel.x + 0.5) / self.tile_px[0]).floor();
        let row = ((pixel.y + 0.5) / self.tile_px[1]).floor();
        if column < 0.0 || row < 0.0 || column >= self.grid[0] as f64 || row >= self.grid[1] as f64 {
            return false;
        }
        self.tiles.get(row as usize * self.grid[0] + column as usize).copied().unwrap_or(false)
    }
}
