"""Makes a scene from videos or photographs of one camera, in one call.

<!-- not run: needs photographs -->
"""

import gsut

result = gsut.scene("walk.mp4", "runs/walk", gsut.SceneOptions(preset="fast"))
print(result.verdict)  # good, usable or poor, with the reasons and what to try next
run = gsut.load_run(result.path)
print(run.gaussians, len(run.scene), "pictures;", result.page)
