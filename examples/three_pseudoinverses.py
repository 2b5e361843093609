"""Resolve one twist of a Panda with three pseudoinverses and compare their norms and kinetic energies.

All three move the tool alike. The plain one has the smallest joint velocity, the inertia-weighted one the smallest
kinetic energy, and the one with the gradient of gravity spends some of both to lower the potential energy.
"""

from __future__ import annotations

import numpy as np

import ik_node

Q = np.array((0.5, 0.6, -0.9, -2.0, 0.8, 2.2, 0.3))
TWIST_B = np.array((0.1, 0.2, 0.0, 0.0, 0.0, 0.5))  # linear part (m/s) first, in the tool frame
GAIN_S = 0.02


def main() -> None:
    """Print one line per method."""
    robot = ik_node.load_robot("panda")
    jacobian = robot.evaluate(Q).jacobian_b
    dynamics = robot.dynamics(Q)
    print("method             |qd| rad/s   1/2 qd'Mqd mJ   gravity g'qd mW   twist error")
    for name in ("plain", "inertia_weighted", "gravity_gradient"):
        weight, gradient = ik_node.METHODS[name](robot, Q, None)
        gain = 0.0 if gradient is None else GAIN_S
        qd = ik_node.resolve(jacobian, TWIST_B, weight, gradient, gain).joint_velocity
        energy = 0.5 * qd @ dynamics.mass_matrix @ qd
        power = dynamics.gravity @ qd
        error = np.abs(jacobian @ qd - TWIST_B).max()
        print(f"{name:16} {np.linalg.norm(qd):12.6f} {1e3 * energy:15.4f} {1e3 * power:17.2f} {error:13.1e}")


if __name__ == "__main__":
    main()
