"""The names of lenses, and where their fits start."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.lenses import find_lens, register, registered, registered_name

OURS = {"BrownConrady": jl.BrownConrady, "Division": jl.Division, "RadialPolynomial": jl.RadialPolynomial}
SHORT = {"brown-conrady": jl.BrownConrady, "division": jl.Division, "radial": jl.RadialPolynomial}


def test_ours_are_there():
    assert registered().items() >= OURS.items()
    for name, lens in (OURS | SHORT).items():
        assert find_lens(name) is lens
    for name, lens in OURS.items():
        assert registered_name(lens) == name
    with pytest.raises(ValueError, match=r"no lens 'fisheye'; there are .*brown-conrady, division, .*radial"):
        find_lens("fisheye")


@pytest.mark.parametrize("lens", OURS.values())
def test_the_identity_distorts_nothing(lens):
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (20, 2))
    for terms in (None, *lens.term_counts):
        np.testing.assert_array_equal(lens.identity(terms=terms).distort(points), jnp.asarray(points))
    count = sum(leaf.size for leaf in np.atleast_1d(getattr(lens.identity(), "coefficients", np.zeros(1))))
    assert count == lens.term_counts[0]
    with pytest.raises(ValueError, match=f"coefficients of {lens.__name__} can be .* got 99"):
        lens.identity(terms=99)


def test_a_lens_without_a_start_says_so():
    class Lost(jl.Lens):
        def distort(self, points):
            return points

    with pytest.raises(NotImplementedError, match="Lost does not say where a fit starts"):
        Lost.identity()


def test_names_are_taken_once():
    def make():
        @register("test.taken", short="taken")
        class Taken(jl.Division):
            pass

        return Taken

    first, again = make(), make()
    assert registered()["test.taken"] is again, "a class defined anew takes its own place"
    assert first is not again
    for name, short in (("test.taken", None), ("other", "taken"), ("taken", None), ("RadialPolynomial", None)):
        with pytest.raises(ValueError, match=r"is the name of .* already"):
            register(name, short=short)(jl.Division)
    assert registered_name(jl.Division) == "Division"
    for name in ("", "two words", "a:b", "1st", "../x"):
        with pytest.raises(ValueError, match="begins with a letter"):
            register(name)
    with pytest.raises(TypeError, match=r"Lens|Class"):
        register("test.map")(jl.CoordinateMap)
