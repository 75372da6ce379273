"""Trains on a dataset, writes a run, and loads it again."""

import gsut

scene = gsut.load_dataset("DATA")
options = gsut.TrainOptions(preset="fast", steps=30, max_gaussians=500)
result = gsut.train(scene, options, out="runs/first", progress=False)
print(result, result.metrics["psnr"])
run = gsut.load_run("runs/first")  # options, scene with refined poses, Gaussians, light
assert len(run.gaussians) == len(result.gaussians)
