"""The certified optimum against a MILP solver (HiGHS, gap 0) over the same candidate groups."""

import pytest

from certificate import MODELS, compare


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_the_optimum_equals_that_of_a_milp_solver(model: str) -> None:
    result = compare(model, frames=100 if model.startswith("exp61") else 20)
    assert result.worst_difference <= 1e-6
    assert result.certified == result.frames


def test_the_optimum_equals_that_of_a_milp_solver_quick() -> None:
    result = compare("exp61 quarter", frames=10)
    assert result.worst_difference <= 1e-6
    assert result.certified == result.frames
