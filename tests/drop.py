"""A scene file of a few particles of water, for tests of what is not in the scene."""

DROP = """
title = "a drop"
[domain]
size = [0.2, 0.2]
cell_size = 0.02
gravity = [0.0, -9.81]
[time]
end = 0.01
[materials.water]
model = "fluid"
density = 1000.0
sound_speed = 15.0
[[bodies]]
material = "water"
shape = { type = "box", min = [0.0, 0.0], max = [0.1, 0.1] }
"""
