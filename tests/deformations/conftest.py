"""What the tests of deformations share."""

import jaxtyping
import pytest


@pytest.fixture
def untyped():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
