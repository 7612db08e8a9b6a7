"""A policy that learns by an evolution strategy: docs/learn.md.

In each generation it tries 16 variants of a linear policy, and goes towards the better ones. It
prints the mean distance of the tip from its target, and writes policy.npz.
"""

from multiprocessing import Pool

import numpy as np

from softdyn.controllers import PolicyNetwork
from softdyn.validation import ReachEnv

SEES = ("q", "v", "error", "target")
SCALE = np.array([1.0] * 4 + [0.1] * 4 + [5.0] * 6)  # what it sees is then near 1
# a decision every 20 ms and plant steps of 1 ms, so that learning is fast
env = ReachEnv("finger", observation=SEES, period=0.02, horizon=1.0, timestep=1e-3)


def network(weights):
    """The linear policy with these 30 weights."""
    layer = weights.reshape(2, 15)  # two inputs; 14 numbers that it sees, and a constant
    return PolicyNetwork([(layer[:, :14] * SCALE, layer[:, 14])], SEES)


def reward_of(variant):
    """The sum of the rewards of one variant over its episodes."""
    weights, seeds = variant
    act, total = network(weights), 0.0
    for seed in seeds:
        seen, over = env.reset(seed=seed)[0], False
        while not over:
            seen, reward, terminated, truncated, _ = env.step(act(seen))
            total, over = total + reward, terminated or truncated
    return total


if __name__ == "__main__":
    random, weights = np.random.default_rng(0), np.zeros(30)
    slope, square = np.zeros(30), np.zeros(30)
    with Pool(2) as pool:
        for k in range(1, 61):
            noise, seeds = random.normal(size=(8, 30)), range(6 * k, 6 * k + 6)
            moved = [weights + size * one for size in (0.1, -0.1) for one in noise]
            rewards = np.array(pool.map(reward_of, [(one, seeds) for one in moved]))
            ranks = rewards.argsort().argsort().reshape(2, 8) / 15
            step = (ranks[0] - ranks[1]) @ noise / 8
            slope, square = 0.9 * slope + 0.1 * step, 0.99 * square + 0.01 * step**2
            weights += 0.06 * slope / (1 - 0.9**k) / np.sqrt(square / (1 - 0.99**k) + 1e-12)
            if k % 15 == 0:
                print(f"{k} generations: mean distance {-24 * rewards.mean() / 300:.1f} cm")
    network(weights).save("policy.npz")
