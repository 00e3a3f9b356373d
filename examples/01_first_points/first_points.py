"""From raw centroids to a C3D in six lines. Replace the simulated take by your own files:

observations = ml.read_observations("take.x2d")       # or .csv, .parquet
rig = ml.read_calibration("take.xcp")                 # or Calib.toml, .qca.txt, .mcal
"""

from pathlib import Path

import markerloom as ml

take = ml.simulate(ml.make_scene("walk", frames=50))
observations, rig = take.observations, take.rig

points = ml.reconstruct(observations, rig)
out = Path("out")
out.mkdir(exist_ok=True)
points.save(out / "first_points.c3d")

report = points.report
print(f"noise {min(report['noise_px'].values()):.2f} to {max(report['noise_px'].values()):.2f} px")
print(f"typical uncertainty {sorted(points.sigma_mm)[len(points) // 2]:.2f} mm")
print(
    f"{len(points)} points in {report['frames']} frames, {100 * report['certified_frames']:.0f} % of frames certified"
)
