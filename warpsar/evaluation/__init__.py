"""How well a scene explains its measured images: `warpsar evaluate`.

command.py             the command and `evaluate`
learned.py             the report of `learn`
image.py               one measured image beside its simulation, and what its metrics hold
metrics.py             metrics of one image and of several together
collected.py           the images of all processes on the first one
residuals.py           what the residual follows: incidence, range, azimuth, brightness, material
meshview.py            parameters on the mesh, as pictures and as PLY
report.py              the report's page
report_numbers.py      its metrics and verdict
report_images.py       its images
report_surface.py      its surface parameters
report_tables.py       its learned tables of sigma0
report_convergence.py  its history of the fit
report_parts.py        what it shares with the report of diagnose
"""
