# SPDX-License-Identifier: Apache-2.0
"""The verdict as a table of findings, each limit from both sides; sizes in um."""

from dataclasses import replace

import pytest

from otf_core.diagnosis.weighing import Case, matters, verdict_of

NAMED = Case(
    simulated_um=1.0,
    before_um=10.0,
    after_um=0.0,
    beyond_um=0.0,
    named=True,
    structured=True,
    left_structured=True,
    left_has_place=False,
    decoyed=False,
)
NOTHING_NAMED = replace(NAMED, named=False, after_um=10.0, beyond_um=10.0)


@pytest.mark.parametrize(
    ('structured', 'before_um', 'simulated_um', 'expected'),
    [
        # a gap with structure counts from 0.35 of what the simulation leaves
        (True, 0.0, 1.0, 'none'),
        (True, 0.349, 1.0, 'none'),
        (True, 0.351, 1.0, 'unknown'),
        (True, 0.699, 2.0, 'none'),
        (True, 0.701, 2.0, 'unknown'),
        # one without from 0.6: the level of noise is not better known
        (False, 0.351, 1.0, 'none'),
        (False, 0.599, 1.0, 'none'),
        (False, 0.601, 1.0, 'unknown'),
        (False, 0.01, 0.0, 'unknown'),
    ],
)
def test_without_a_cause_only_the_size_of_the_gap_counts(
    structured, before_um, simulated_um, expected
):
    case = replace(
        NOTHING_NAMED, structured=structured, before_um=before_um, simulated_um=simulated_um
    )
    for rest in (0.0, 0.5, 50.0):
        for has_place in (True, False):
            other = replace(case, after_um=rest, beyond_um=rest, left_has_place=has_place)
            assert verdict_of(other) == expected


@pytest.mark.parametrize(
    ('has_place', 'after_um', 'expected'),
    [
        # what is left without a place: up to 0.3 of the gap
        (False, 0.0, 'explained'),
        (False, 2.99, 'explained'),
        (False, 3.01, 'partly_explained'),
        (False, 10.0, 'partly_explained'),
        # with a place it may be part of another cause: up to 0.1
        (True, 0.99, 'explained'),
        (True, 1.01, 'partly_explained'),
        (True, 2.99, 'partly_explained'),
    ],
)
def test_named_cause_explains_if_little_is_left(has_place, after_um, expected):
    case = replace(NAMED, after_um=after_um, left_has_place=has_place)
    assert verdict_of(case) == expected


@pytest.mark.parametrize(
    ('has_place', 'beyond_um', 'expected'),
    [
        # the catalogue as a whole leaves more than 0.55 (0.25): the true cause is not in it
        (False, 5.49, 'partly_explained'),
        (False, 5.51, 'unknown'),
        (True, 2.49, 'partly_explained'),
        (True, 2.51, 'unknown'),
    ],
)
def test_named_cause_falls_if_the_whole_catalogue_leaves_much(has_place, beyond_um, expected):
    case = replace(NAMED, after_um=9.0, beyond_um=beyond_um, left_has_place=has_place)
    assert verdict_of(case) == expected


@pytest.mark.parametrize(
    ('structured', 'has_place', 'left_um', 'expected'),
    [
        (True, False, 0.349, 'explained'),
        (True, False, 0.351, 'unknown'),
        (False, True, 0.349, 'explained'),
        (False, True, 0.351, 'unknown'),
        # without structure and place: as far as the level of noise is known
        (False, False, 0.599, 'explained'),
        (False, False, 0.601, 'unknown'),
    ],
)
def test_a_rest_that_does_not_matter_beside_the_noise_is_no_rest(
    structured, has_place, left_um, expected
):
    """A gap of 0.61: all of it is left as a share, and yet less than the simulation tells."""
    case = replace(
        NAMED,
        before_um=0.61,
        after_um=left_um,
        beyond_um=left_um,
        left_structured=structured,
        left_has_place=has_place,
    )
    assert verdict_of(case) == expected


def test_shares_are_amplitudes_whatever_the_size_of_all():
    for scale in (1e-3, 1.0, 1e3):
        for after, expected in ((2.99, 'explained'), (3.01, 'partly_explained')):
            case = replace(NAMED, before_um=10 * scale, after_um=after * scale, simulated_um=scale)
            assert verdict_of(case) == expected


@pytest.mark.parametrize(
    ('named', 'before_um', 'expected'),
    [(True, 0.0, 'unknown'), (True, 10.0, 'unknown'), (False, 0.34, 'none'),
     (False, 0.36, 'unknown'), (False, 10.0, 'unknown')],
)  # fmt: skip
def test_shapes_outside_the_catalogue_make_the_cause_of_a_gap_unknown(named, before_um, expected):
    """Of a gap: with none, and no cause named, there is nothing to explain."""
    case = replace(NAMED, named=named, before_um=before_um, simulated_um=1.0, decoyed=True)
    assert verdict_of(case) == expected


@pytest.mark.parametrize(
    ('gap_um', 'simulated_um', 'expected'),
    [(0.349, 1.0, False), (0.351, 1.0, True), (0.69, 2.0, False), (0.71, 2.0, True),
     (0.0, 0.0, False), (1e-9, 0.0, True)],
)  # fmt: skip
def test_a_gap_matters_from_a_third_of_the_simulated_residual_on(gap_um, simulated_um, expected):
    assert matters(gap_um, simulated_um) is expected
