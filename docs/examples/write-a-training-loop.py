"""Takes one training step by hand; a whole loop is in [forty lines](../training-loop.md)."""

import gsut

scene = gsut.load_dataset("DATA")
start = gsut.seed_from_points(scene.points, scene.point_colors, sh_degree=1)
optimizer = gsut.GaussianOptimizer(start, capacity=2 * len(start))
target = gsut.PhotometricTarget(scene.image(0), scene.mask(0))
rendered = gsut.render(optimizer.gaussians, scene.camera(0), scene.views[0].motion)
loss, dimage = gsut.photometric_loss(target, rendered.image)
gradients = gsut.render_backward(rendered, dimage)
rates = gsut.loop.compute_learning_rates(gsut.TrainOptions().recipe, 0.0, scene.extent)
optimizer.step(gradients.gaussians, rates, visible=gradients.touched)
