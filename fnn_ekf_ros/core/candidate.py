"""The relocation candidate's filter in the bank, its noise, and moving the robot there."""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, select
from fnn_ekf_ros.core.bank import Bank, Noise, correct, innovate, noise_of_readings
from fnn_ekf_ros.core.gate import Verdict
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.relocation import Beside, Candidate, Followed, follow, nis_by_sensor
from fnn_ekf_ros.core.state import PUBLISHED, FilterModel, FilterState, reset_pose


def follow_candidate(
    model: FilterModel, state: FilterState, instant: Instant, verdict: Verdict, corrected: Bank
) -> Followed:
    """Take the candidate on, or start one."""
    if state.has_candidate(model):
        beside = _beside(model, state, instant)
    else:
        beside = Beside(
            instant.predicted.filters(PUBLISHED),
            instant.seen.filters(PUBLISHED),
            instant.noise.filters(PUBLISHED),
            verdict.nis,
        )
    return follow(
        model.gate,
        state.gate,
        state.candidate,
        beside,
        corrected.filters(PUBLISHED),
        instant.readings,
        verdict,
    )


def with_candidate(model: FilterModel, state: FilterState, followed: Followed) -> FilterState:
    """Return the state with the candidate, or at the candidate's pose where it is confirmed."""
    state = _with_filter(model, state, followed.candidate, followed.place)
    confirmed = followed.relocation.confirmed
    return _relocated(model, state, confirmed) if confirmed.any() else state


def _with_filter(
    model: FilterModel, state: FilterState, candidate: Candidate, place: Bank
) -> FilterState:
    """Return the state with the candidate's filter in the bank, where any robot has one."""
    steady, before = model.layout.steady, state.candidate.active
    own = state.noise.filters(model.layout.candidate if before.any() else PUBLISHED)
    bank, noise = state.bank.filters(steady), state.noise.filters(steady)
    if not candidate.active.any():
        return state._replace(bank=bank, noise=noise, candidate=candidate)
    return state._replace(
        bank=Bank(
            np.concatenate([bank.mean, place.mean], axis=1),
            np.concatenate([bank.covariance, place.covariance], axis=2),
        ),
        noise=Noise(
            _with_own(noise.process, own.process, before),
            _with_own(noise.measurement, own.measurement, before),
        ),
        candidate=candidate,
    )


def _relocated(model: FilterModel, state: FilterState, confirmed: BoolArray) -> FilterState:
    """Return the filters of robots that a candidate was confirmed for at its pose."""
    place = state.bank.filters(model.layout.candidate)
    moved = reset_pose(model, state, place.mean[:, 0], place.covariance[:, :, 0])
    if confirmed.all():
        return moved
    moved = moved._replace(
        bank=Bank(
            np.where(confirmed, place.mean, state.bank.mean),
            np.where(confirmed, place.covariance, state.bank.covariance),
        ),
        noise=state.noise,
    )
    chosen: FilterState = select(confirmed, moved, state)
    return chosen


def _beside(model: FilterModel, state: FilterState, instant: Instant) -> Beside:
    """Return the candidate's filter; robots that have no candidate yet take the noise in use."""
    own = model.layout.candidate
    predicted, available = instant.predicted.filters(own), instant.readings.available
    noise = noise_of_readings(
        select(state.candidate.active, state.noise.filters(own), state.noise.filters(PUBLISHED)),
        model.measurement_noise,
        instant.fix_covariance,
        available,
    )
    seen = innovate(predicted, instant.readings, noise.measurement)
    nis = nis_by_sensor(seen, correct(predicted, seen, noise, available), 0)
    return Beside(predicted, seen, noise, nis)


def _with_own(of_all: FloatArray, own: FloatArray, kept: BoolArray) -> FloatArray:
    """Return noise with a candidate's: its own where it is kept, or the published filter's."""
    return np.concatenate([of_all, np.where(kept, own, of_all[:, PUBLISHED])], axis=1)
