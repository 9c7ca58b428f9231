"""How well a scene explains its measured images: `warpsar evaluate`.

command.py             the command and `evaluate`
learned.py             the report of `learn`
residuals.py           what the residual follows: incidence, range, azimuth, brightness, material
meshview.py            parameters on the mesh, as pictures and as PLY
report.py              the report's page
report_numbers.py      its metrics and verdict
report_images.py       its images
report_curves.py       its curves of RCS, and the page of a scene that has nothing else
report_prediction.py   its test views beside rivals that need no physics
report_parts.py        what it shares with the report of diagnose
"""
