"""gymnax's CartPole under jit, timed on request; run by the python of an environment that has gymnax.

Each line of standard input, ``WAY TABLES CALLS``, is answered by the CPU seconds of so many calls of
`STEPS` steps each. WAY is ``stepped`` (a jitted call a step, its observations brought to the host, as an
agent outside of jax needs them) or ``scanned`` (a jitted loop over all steps, which nothing leaves).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import gymnax
import jax
import jax.numpy as jnp
import numpy as np

STEPS = 50
ENV, PARAMS = gymnax.make("CartPole-v1")


def _step(keys: Any, state: Any, action: Any) -> Any:
    split = jax.vmap(jax.random.split)(keys)
    moved = jax.vmap(ENV.step, in_axes=(0, 0, 0, None))(split[:, 0], state, action, PARAMS)
    observation, state, reward = moved[:3]
    return split[:, 1], state, observation, reward


@lru_cache
def maker(way: str, tables: int) -> Callable[[], None]:
    """Return a call of `STEPS` steps of so many environments, compiled."""
    keys = jax.random.split(jax.random.key(0), tables)
    _, state = jax.vmap(ENV.reset, in_axes=(0, None))(keys, PARAMS)
    action = jnp.ones(tables, dtype=jnp.int32)
    step = jax.jit(_step)
    carry = [keys, state]

    def stepped() -> None:
        for _ in range(STEPS):
            *carry[:], observation, reward = step(*carry, action)
            np.asarray(observation), np.asarray(reward)

    @jax.jit
    def loop(keys: Any, state: Any) -> Any:
        def body(carried: Any, _: Any) -> Any:
            keys, state, observation, reward = _step(*carried, action)
            return (keys, state), observation.sum() + reward.sum()

        return jax.lax.scan(body, (keys, state), length=STEPS)

    def scanned() -> None:
        carry[:], outputs = loop(*carry)
        outputs.block_until_ready()

    call = stepped if way == "stepped" else scanned
    call()  # compiles
    return call


def main() -> None:
    for line in sys.stdin:
        way, tables, calls = line.split()
        call = maker(way, int(tables))
        begin = time.process_time()
        for _ in range(int(calls)):
            call()
        print(time.process_time() - begin, flush=True)


if __name__ == "__main__":
    main()
