// Generated from python/markerloom/studio/messages.py by `python -m markerloom.studio.wire`: do not edit.

/**
 * What a rig is worth: cells (x slowest, z fastest) with the cameras that see them and the expected error (mm, −1
 * where fewer than two cameras do), for dots with this noise (px).
 */
export interface AccuracyView {
  x_m: number[];
  y_m: number[];
  z_m: number[];
  cameras: number[];
  sigma_mm: number[];
  noise_px: number;
  median_mm: number;
}

/**
 * A trajectory, by its place (mm, world, Z up) in a frame.
 */
export interface At {
  frame: number;
  xyz_mm: [number, number, number];
}

/**
 * What one camera had in a frame.
 */
export interface CameraFrame {
  camera: string;
  dots: DotView[];
  reprojections: ReprojectionView[];
}

/**
 * A camera for the eye: place (m), axes (rows: right, down, forward in world), image and focal length (px).
 */
export interface CameraView {
  id: string;
  name: string;
  position_m: [number, number, number];
  axes: [[number, number, number], [number, number, number], [number, number, number]];
  size_px: [number, number];
  focal_px: [number, number];
  masked: [number, number, number, number][];
  video: boolean;
}

/**
 * A place of a foot that stands over these frames (both included).
 */
export interface ContactView {
  site: string;
  first: number;
  last: number;
}

/**
 * How often each camera saw something in each cell of its image: counts row by row.
 */
export interface CoverageView {
  camera: string;
  columns: number;
  rows: number;
  counts: number[];
  dots: number;
  used: number;
  residual_px: number;
}

/**
 * Throw away the samples of a trajectory over frames ``within``.
 */
export interface Delete {
  op: "delete";
  at: At;
  within: Range;
}

/**
 * What was done, in words.
 */
export interface Done {
  message: string;
  path?: string;
}

/**
 * A centroid: its place (px), row within its frame and camera, whose it is (slot, −1: nobody's), if left out.
 */
export interface DotView {
  x: number;
  y: number;
  observation: number;
  slot: number;
  excluded: boolean;
}

/**
 * What all cameras had in a frame.
 */
export interface DotsView {
  frame: number;
  cameras: CameraFrame[];
}

/**
 * Make an edit; ``revision`` is the one the page was looking at.
 */
export interface EditRequest {
  revision: number;
  edit: Label | Unlabel | Swap | Split | Join | Delete | Fill | Smooth | Move | ExcludeDot | ExcludeCamera | ExcludeRegion | MarkContact;
}

/**
 * An edit of the list: what it does in words, and why it does not fit, where it does not.
 */
export interface EditView {
  op: string;
  words: string;
  unfit: string;
}

/**
 * Leave out all centroids of a camera over frames ``within`` before reconstruction.
 */
export interface ExcludeCamera {
  op: "exclude_camera";
  camera: string;
  within: Range;
}

/**
 * Leave out one centroid before reconstruction: the one of a camera nearest to ``pixel``.
 */
export interface ExcludeDot {
  op: "exclude_dot";
  camera: string;
  frame: number;
  pixel: [number, number];
}

/**
 * Leave out the centroids in a rectangle of a camera's image (corners, px) over frames ``within``.
 */
export interface ExcludeRegion {
  op: "exclude_region";
  camera: string;
  low: [number, number];
  high: [number, number];
  within: Range;
}

/**
 * Write the mended take; ``file``: a name with an ending, in the take's own folder of results.
 */
export interface ExportRequest {
  file: string;
  overwrite?: boolean;
}

/**
 * Fill the gaps of a trajectory that lie in frames ``within``; ``predicted``: what a tracker carried there, too.
 */
export interface Fill {
  op: "fill";
  at: At;
  within: Range;
  method?: string;
  predicted?: boolean;
}

/**
 * Something worth a look: a gap, a high residual, a name that may be wrong. Frames of the take, both included.
 */
export interface Finding {
  kind: "gap" | "residual" | "name" | "jump" | "unlabelled";
  slot: number;
  first: number;
  last: number;
  text: string;
}

/**
 * All findings in order of time, and what was not looked for.
 */
export interface Findings {
  revision: number;
  findings: Finding[];
  notes: string[];
}

/**
 * The samples of ``other`` become those of ``at``; the two must not have a frame in common.
 */
export interface Join {
  op: "join";
  at: At;
  other: At;
}

/**
 * Give a trajectory a name; over frames ``within``, or all along.
 */
export interface Label {
  op: "label";
  at: At;
  name: string;
  within?: Range | null;
}

/**
 * A place of a foot stands on the floor over frames ``within``; or does not, where ``stands`` is false.
 */
export interface MarkContact {
  op: "contact";
  site: string;
  within: Range;
  stands?: boolean;
}

/**
 * A marker set that can be edited; ``links``: pairs that are rigidly joined.
 */
export interface MarkerSetView {
  name: string;
  title: string;
  markers: MarkerView[];
  links: [string, string][];
}

/**
 * A marker of a set: side (left, right, middle), segment, colour; place as parts of the stature, or none.
 */
export interface MarkerView {
  name: string;
  side: "left" | "right" | "middle";
  segment: string;
  color: string;
  place: [number, number, number] | null;
}

/**
 * Put one sample somewhere else; it is of kind ``edited`` from then on.
 */
export interface Move {
  op: "move";
  at: At;
  xyz_mm: [number, number, number];
}

/**
 * What the server tells without being asked: states of takes, and of the file of the one that is open.
 */
export interface Notice {
  instance: string;
  takes: TakeInfo[];
  revisions: Record<string, number>;
  sources: Record<string, "ok" | "changed" | "gone">;
}

/**
 * How a method would fill a gap: places (mm) by frame, expected error (mm); ``reason`` where it cannot.
 */
export interface Preview {
  method: string;
  first: number;
  xyz_mm: [number, number, number][];
  expected_mm: number;
  reason: string;
}

/**
 * What went wrong, and what to do.
 */
export interface Problem {
  error: "refused" | "invalid" | "conflict" | "missing" | "failed";
  message: string;
}

/**
 * What is open: a project, or a file as a project of one take. ``instance``: changes when the server restarts.
 */
export interface ProjectView {
  name: string;
  is_project: boolean;
  takes: TakeInfo[];
  instance: string;
  version: string;
}

/**
 * Frames ``first`` to ``last``, both included.
 */
export interface Range {
  first: number;
  last: number;
}

/**
 * The ray of a centroid that made a marker: its camera, and its direction in world (unit length).
 */
export interface RayView {
  camera: string;
  direction: [number, number, number];
}

/**
 * A rig adjusted to the take: residuals (px rms) on frames left out, before and after, and where the cameras go.
 */
export interface RefinedView {
  verdict: string;
  reasons: string[];
  before_px: number;
  after_px: number;
  cameras: CameraView[];
  moved_mm: Record<string, number>;
  turned_deg: Record<string, number>;
}

/**
 * Where a camera must see a trajectory (px).
 */
export interface ReprojectionView {
  slot: number;
  x: number;
  y: number;
}

/**
 * Undo, redo or process, as seen at ``revision``.
 */
export interface RevisionRequest {
  revision: number;
}

/**
 * A trajectory, or a joint, over a stretch of frames, thinned: for each bin its first frame, and the least and the
 * largest of each value in it (none where absent). Of trajectories ``x``, ``y``, ``z`` (mm), ``speed`` (m/s),
 * ``residual``, ``sigma`` (mm); of joints turns about ``x``, ``y``, ``z`` (deg).
 */
export interface Series {
  frames: number[];
  lows: Record<string, (number | null)[]>;
  highs: Record<string, (number | null)[]>;
}

/**
 * A solved skeleton: joints, each with its parent (−1: root), ends of bones with the joint that each belongs to,
 * and places of feet that can stand. ``stale``: edits came after it was solved.
 */
export interface SkeletonView {
  joints: string[];
  parents: number[];
  ends: number[];
  feet: string[];
  stale: boolean;
}

/**
 * Smooth a trajectory over frames ``within``.
 */
export interface Smooth {
  op: "smooth";
  at: At;
  within: Range;
  method?: string;
  cutoff_hz?: number;
}

/**
 * Cut a trajectory: what comes from ``frame`` on becomes one of its own, without a name.
 */
export interface Split {
  op: "split";
  at: At;
  frame: number;
}

/**
 * A subject's name, and the markers that stay: each by its present name, with the one it gets.
 */
export interface SubjectEdit {
  name: string;
  markers: Record<string, string>;
}

/**
 * Learn a subject from the take as it is, and save it as NAME.toml in the project's folder.
 */
export interface SubjectRequest {
  name: string;
  overwrite?: boolean;
}

/**
 * A subject of the project: its markers, and the distances that vary least (two markers, mean and sd in mm).
 */
export interface SubjectView {
  file: string;
  name: string;
  marker_set: string;
  markers: string[];
  poses: number;
  firmest: [string, string, number, number][];
}

/**
 * A name that a trajectory may have: how far its distances to its neighbours are off (mm, rms).
 */
export interface Suggestion {
  name: string;
  off_mm: number;
}

/**
 * Exchange the samples of two trajectories over frames ``within``.
 */
export interface Swap {
  op: "swap";
  at: At;
  other: At;
  within: Range;
}

/**
 * A take of the project: its name, its file, and whether it can be shown, is being worked on, or failed.
 */
export interface TakeInfo {
  name: string;
  file: string;
  state: "closed" | "working" | "ready" | "failed";
  message: string;
}

/**
 * Everything of a take but its samples. ``revision`` goes up with every change; an edit names the one it saw.
 */
export interface TakeView {
  name: string;
  file: string;
  revision: number;
  first_frame: number;
  frames: number;
  rate_hz: number;
  trajectories: TrajectoryView[];
  links: [number, number][];
  cameras: CameraView[];
  has_dots: boolean;
  dots_pending: boolean;
  residual_unit: "px" | "mm" | "";
  typical_residual: number;
  skeleton: SkeletonView | null;
  contacts: ContactView[];
  can_solve: boolean;
  edits: EditView[];
  can_undo: boolean;
  can_redo: boolean;
  suggested_names: string[];
  warnings: string[];
  chunk_frames: number;
  overview_stride: number;
  export_name: string;
}

/**
 * Runs of samples of one kind, of every trajectory by slot: flat triples start (row of the take), length, kind (0
 * measured, 1 predicted, 2 filled, 3 edited).
 */
export interface Timeline {
  revision: number;
  runs: number[][];
}

/**
 * A trajectory: its place among the slots of a chunk, label (may be empty), name, colour, number of samples.
 */
export interface TrajectoryView {
  slot: number;
  label: string;
  name: string;
  color: string;
  samples: number;
}

/**
 * Take a trajectory its name; over frames ``within``, or all along.
 */
export interface Unlabel {
  op: "unlabel";
  at: At;
  within?: Range | null;
}

/**
 * Why a marker is missing, or what it is made of, in words; a line for each camera where there are dots.
 */
export interface Why {
  text: string;
  lines: string[];
  rays: RayView[];
}
