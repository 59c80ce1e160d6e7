"""Random streams by name: one seed, one independent stream per (what, whom, ...).

Stage 0. A stream depends on the seed and its names alone, never on the order of entries or on what
else was drawn, so that run 731 of a sweep replays alone.

The runs of a batch ask for the first word of many streams, and to set a generator up takes a hundred
times as long as to draw a word. So the first words of many are computed together, as NumPy computes
them: `SeedSequence` and SFC64 are promised not to change, and a test compares.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Words = npt.NDArray[np.uint32]
LongWords = npt.NDArray[np.uint64]

# Serial numbers, each with many names, and runs, whose first words are computed together.
SERIALS_AT_ONCE, RUNS_AT_ONCE = 32, 256
POOL = 4  # words, of SeedSequence
MIX_LEFT, MIX_RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
ROUNDS = 12  # of SFC64, before the first word


def _powers(first: int, by: int, count: int) -> Words:
    """What SeedSequence hashes one word after the other with, (count + 1, 1, 1)."""
    found = [first * pow(by, i, 2**32) % 2**32 for i in range(count + 1)]
    return np.array(found, dtype=np.uint32)[:, None, None]


# For what goes in, a pool, the pool with itself and another pool, and for what comes out.
HASH_IN = _powers(0x43B0D7E5, 0x931E8875, POOL + POOL * (POOL - 1) + POOL * POOL)
HASH_OUT = _powers(0x8B51F9DD, 0x58F38DED, 6)


def stream(seed: int, *names: str) -> np.random.Generator:
    """Generator for `seed` (0 or greater) and a sequence of names."""
    key = tuple(_key(names).tolist())
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))


def _key(names: Sequence[str]) -> Words:
    """(4,)"""
    digest = hashlib.sha256("\0".join(names).encode()).digest()
    return np.frombuffer(digest[:16], dtype="<u4")


def unit_errors(serial: int, names: tuple[str, ...], quantity: str) -> list[float]:
    """Figures in [-1, 1), uniform, each fixed for one component of one machine.

    A tolerance is a limit, so the errors of a batch of components fill it evenly. Each is what
    stream(serial, "machine", name, quantity).uniform(-1, 1) gives.
    """
    block, place = divmod(serial, SERIALS_AT_ONCE)
    found: list[float] = _unit_errors(block, names, quantity)[place].tolist()
    return found


@functools.lru_cache(maxsize=16)
def _unit_errors(block: int, names: tuple[str, ...], quantity: str) -> npt.NDArray[np.float64]:
    """(serials of the block, names)"""
    serials = range(block * SERIALS_AT_ONCE, (block + 1) * SERIALS_AT_ONCE)
    words = first_words(serials, [_key(("machine", name, quantity)) for name in names])
    return -1.0 + 2.0 * ((words >> np.uint64(11)).astype(np.float64) * 2.0**-53)


def run_seed(seed: int, names: tuple[str, ...], run: int) -> int:
    """stream(seed, *names, str(run)).integers(2**53): a seed for each of many runs."""
    block, place = divmod(run, RUNS_AT_ONCE)
    return int(_run_seeds(seed, names, block)[place])


@functools.lru_cache(maxsize=16)
def _run_seeds(seed: int, names: tuple[str, ...], block: int) -> LongWords:
    """(runs of the block,)"""
    runs = range(block * RUNS_AT_ONCE, (block + 1) * RUNS_AT_ONCE)
    words = first_words([seed], [_key((*names, str(run))) for run in runs]) >> np.uint64(11)
    return words.reshape(-1)


def first_words(seeds: Sequence[int], keys: Sequence[Words]) -> LongWords:
    """The first word of SFC64 for each of the seeds, below 2^128, with each key, (seeds, keys)."""
    entropy = np.empty((2 * POOL, len(seeds), len(keys)), dtype=np.uint32)
    for i in range(POOL):
        words = [seed >> 32 * i & 0xFFFFFFFF for seed in seeds]
        entropy[i] = np.array(words, dtype=np.uint32)[:, None]
    entropy[POOL:] = np.array(keys).T[:, None, :]
    low, high = np.split(_state(entropy).astype(np.uint64).reshape(3, 2, len(seeds), -1), 2, axis=1)
    a, b, c = (low | high << np.uint64(32))[:, 0]
    for count in range(1, ROUNDS + 1):
        word = a + b + np.uint64(count)
        a, b = b ^ b >> np.uint64(11), c + (c << np.uint64(3))
        c = (c << np.uint64(24) | c >> np.uint64(40)) + word
    first: LongWords = a + b + np.uint64(ROUNDS + 1)
    return first


def _state(entropy: Words) -> Words:
    """SeedSequence.generate_state of six words, for entropy of two pools, (2 * POOL, ...)."""
    pool, done = _hashed(entropy[:POOL], HASH_IN[: POOL + 1]), POOL
    for i in range(POOL):
        others = [k for k in range(POOL) if k != i]
        pool[others] = _mixed(pool[others], _hashed(pool[i], HASH_IN[done : done + POOL]))
        done += POOL - 1
    for more in entropy[POOL:]:
        pool = _mixed(pool, _hashed(more, HASH_IN[done : done + POOL + 1]))
        done += POOL
    return _hashed(pool[[0, 1, 2, 3, 0, 1]], HASH_OUT)


def _hashed(words: Words, powers: Words) -> Words:
    found: Words = (words ^ powers[:-1]) * powers[1:]
    return found ^ found >> np.uint32(16)


def _mixed(left: Words, right: Words) -> Words:
    found: Words = MIX_LEFT * left - MIX_RIGHT * right
    return found ^ found >> np.uint32(16)
