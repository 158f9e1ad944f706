"""A batch that is sharded over devices is computed where it is: no device ever holds another's pictures."""

import json
import os
import subprocess
import sys

import pytest

DEVICES = 4
# Prints, for each of the cases, whether values and sharding are kept, and the shapes that are gathered.
CODE = """
import json, re
import jax
import numpy as np
import jaxlens as jl

mesh = jax.sharding.Mesh(np.array(jax.devices()), ("batch",))
over = jax.NamedSharding(mesh, jax.P("batch"))
generator = np.random.default_rng(0)
found = {}


def check(name, through, *arguments):
    function = jax.jit(jax.vmap(through))
    expected = function(*arguments)
    sharded = jax.device_put(arguments, over)
    compiled = function.lower(*sharded).compile()
    result = compiled(*sharded)
    movements = "all-gather|all-to-all|collective-permute"
    gathered = re.findall(rf"= \\(?\\w+\\[([\\d,]*)\\][^=]* (?:{movements})", compiled.as_text())
    found[name] = {
        "largest difference": float(np.abs(np.asarray(result, float) - np.asarray(expected)).max()),
        "sharded": bool(result.sharding.is_equivalent_to(over, result.ndim)),
        "gathered": max([0] + [int(np.prod([int(n) for n in shape.split(",") if n])) for shape in gathered]),
        "devices": len(result.sharding.device_set),
    }


# Large enough for the members of a batch to take turns.
images = generator.uniform(0, 255, (8, 200, 180, 3)).astype(np.float32)
# Pincushion: at a fold rounding grows to its root in an inverse.
radial = jax.vmap(jl.RadialPolynomial)(generator.uniform(0, 0.2, (8, 2)).astype(np.float32))
brown = jax.vmap(jl.BrownConrady)(generator.uniform(-0.05, 0.05, (8, 5)).astype(np.float32))
frames = jax.vmap(jl.Frame)(np.full((8, 2), 100, np.float32), np.full((8, 2), 200, np.float32))
check("undistort_image radial", jl.undistort_image, images, radial)
check("distort_image radial", jl.distort_image, images, radial)
check("undistort_image brown", lambda image, lens, frame: jl.undistort_image(image, lens, frame=frame),
      images, brown, frames)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found():
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count={DEVICES}"
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    run = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


@pytest.mark.parametrize("name", ["undistort_image radial", "distort_image radial", "undistort_image brown"])
def test_a_sharded_batch_stays_where_it_is(found, name):
    case = found[name]
    # Values between 0 and 255: no more than the rounding of coordinates, which XLA fuses otherwise.
    assert case["largest difference"] < 255 * 200 * 2.0**-22
    assert case["devices"] == DEVICES
    assert case["sharded"]
    # A lens's few numbers may travel; a picture, a channel or a plane of coordinates may not.
    assert case["gathered"] < 8 * 16
