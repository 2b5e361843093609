"""``ros2 launch ik_node ik_node.launch.py``: arguments, errors, topics, and the end of both processes.

Launch is not on the package index; these tests run where ``ros2launch`` can be imported, with Jazzy's installation or
its sources on PYTHONPATH. The package ``launch`` of the index is another one.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from domains import own_domain
from loop import READY, make_robot
from ros_peer import FakeArm, Peer, peer_in_own_domain, rclpy
from waiting import wait_until

from ik_node.robot.catalogue import ARMS, robots_folder
from ik_node.ros import qos

if rclpy:
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters
    from sensor_msgs.msg import JointState

pytest.importorskip("ros2launch", reason="launch, launch_ros and ros2cli are not on the package index")

PROJECT = Path(__file__).resolve().parents[2]
ROS2 = [sys.executable, "-c", "import sys; from ros2cli.cli import main; sys.exit(main())"]
LAUNCH = [*ROS2, "launch", "ik_node", "ik_node.launch.py"]
ARGUMENTS = ("robot", "urdf", "params_file", "namespace", "command_topic", "use_sim_time", "watchdog")
PARAMETERS = """
/**:
  ik_node:
    ros__parameters:
      base_frame: panda_link0
      tip_frame: panda_hand_tcp
      rate_hz: 10.0
      state.timeout_s: 10.0
      follow.enabled: false
      limits.velocity_fraction: 0.05
  ik_watchdog:
    ros__parameters:
      timeout_s: 5.0
"""
"""For joint states at some 15 Hz, or 3 Hz on a busy machine."""
SLOW_RAMP = 0.008
"""Acceleration with which a ramp from 0.1 rad/s takes longer than the 10 s that launch allows by default, rad/s2."""


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package in the layout that colcon installs."""
    root: Path = tmp_path_factory.mktemp("prefix")
    share, executables = root / "share" / "ik_node", root / "lib" / "ik_node"
    index = root / "share" / "ament_index" / "resource_index" / "packages"
    for folder in (share, executables, index):
        folder.mkdir(parents=True)
    (index / "ik_node").touch()
    for name in ("config", "launch"):  # ros2 launch does not search below links
        shutil.copytree(PROJECT / name, share / name)
    for module in ("node", "watchdog"):
        path = executables / ("ik_node" if module == "node" else f"ik_{module}")
        path.write_text(f"#!{sys.executable}\nimport sys\nfrom ik_node.cli.{module} import main\nsys.exit(main())\n")
        path.chmod(0o755)
    return root


class Launched:
    """A running ``ros2 launch``, in a process group of its own like in a terminal."""

    def __init__(self, prefix: Path, log: Path, arguments: list[str], domain: int) -> None:
        self.log = log
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [*LAUNCH, *arguments],
                env=environment(prefix) | {"ROS_DOMAIN_ID": str(domain)},
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def text(self) -> str:
        return self.log.read_text(errors="replace")

    def ctrl_c(self) -> None:
        """SIGINT to the process group, as a terminal sends it."""
        os.killpg(self.process.pid, signal.SIGINT)


def environment(prefix: Path) -> dict[str, str]:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "")
    return {**os.environ, "AMENT_PREFIX_PATH": f"{prefix}{os.pathsep}{prefixes}", "PYTHONUNBUFFERED": "1"}


def launched_to_its_end(prefix: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*LAUNCH, *arguments], env=environment(prefix), capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain("/left/ik_node") as found:
        yield found


def test_arguments_are_listed(prefix: Path) -> None:
    shown = launched_to_its_end(prefix, "--show-args").stdout
    listed = [line.strip().strip("':") for line in shown.splitlines() if line.startswith("    '")]
    assert tuple(listed) == ARGUMENTS
    assert "panda" in shown and "no description given" not in shown


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["robot:=pandar"], "unknown robot 'pandar'; valid: kinova, panda, "),
        (["robot:=panda", "urdf:=arm.urdf"], "robot and urdf exclude each other"),
        (["urdf:=/nowhere/arm.urdf"], "urdf: no file '/nowhere/arm.urdf'"),
        (["urdf:=ARM.xacro"], "write the URDF with: xacro "),
        (["params_file:=/nowhere/my.yaml"], "params_file: no file '/nowhere/my.yaml'"),
        (["use_sim_time:=yes"], "use_sim_time is 'yes'; valid: true, false"),
        (["watchdog:=1"], "watchdog is '1'; valid: true, false"),
        (["robto:=panda"], "unknown argument 'robto'; valid: robot, urdf, "),
    ],
)
def test_wrong_arguments_end_with_one_line(prefix: Path, tmp_path: Path, arguments: list[str], reason: str) -> None:
    xacro = tmp_path / "arm.urdf.xacro"
    xacro.write_text("<robot/>")
    process = launched_to_its_end(prefix, *(argument.replace("ARM.xacro", str(xacro)) for argument in arguments))
    errors = [line for line in (process.stdout + process.stderr).splitlines() if "INFO" not in line]
    assert len(errors) == 1 and reason in errors[0], errors
    assert process.returncode == 1


@pytest.fixture
def moving(prefix: Path, peer: Peer, tmp_path: Path) -> Iterator[tuple[Launched, FakeArm]]:
    """Node and watchdog in a namespace, with a URDF, a parameter file and another command topic; the arm moves."""
    parameters = tmp_path / "my.yaml"
    parameters.write_text(PARAMETERS)
    topic = "/left/controller/commands"
    peer.subscribe_commands(topic)
    peer.states_publisher = peer.node.create_publisher(JointState, "/left/joint_states", qos.OUTPUT)
    urdf = robots_folder() / ARMS["panda"].urdf
    arguments = [f"urdf:={urdf}", f"params_file:={parameters}", "namespace:=left", f"command_topic:={topic}"]
    running = Launched(prefix, tmp_path / "launch.log", arguments, peer.domain)
    try:
        arm = FakeArm(peer, make_robot("panda"), READY["panda"])
        peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
        peer.until("the watchdog", lambda: "ready: zeros on /left/controller/commands after 5 s" in running.text, arm)
        goal = arm.pose()
        goal[2, 3] -= 0.2

        def each() -> None:
            arm()
            peer.send_target(goal, "panda_link0")

        peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.1), each)
        yield running, arm
    finally:
        with suppress(ProcessLookupError):
            os.killpg(running.process.pid, signal.SIGKILL)
        running.process.wait()


def ended(running: Launched) -> bool:
    """Whether launch and all processes of its group have ended."""
    if running.process.poll() is None:
        return False
    try:
        os.killpg(running.process.pid, 0)
    except ProcessLookupError:
        return True
    return False


def fastest(peer: Peer) -> list[float]:
    return [float(np.abs(command).max()) for command in peer.commands]


def test_ctrl_c_ramps_to_rest(peer: Peer, moving: tuple[Launched, FakeArm]) -> None:
    running, arm = moving
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[SLOW_RAMP])
    request = SetParameters.Request(parameters=[Parameter(name="limits.acceleration", value=value)])
    assert peer.call(SetParameters, "/left/ik_node/set_parameters", request, arm).results[0].successful
    count, begin_ns = len(peer.commands), time.monotonic_ns()
    running.ctrl_c()
    peer.until("the end", lambda: ended(running), arm)
    assert fastest(peer)[-1] == 0.0
    last_ns = max(at for at, speed in zip(peer.command_times_ns, fastest(peer), strict=True) if speed > 0.0)
    assert last_ns - begin_ns > 10e9
    steps = np.diff(np.array(peer.commands[count:]), axis=0)
    assert np.abs(steps).max() < 0.02
    assert "the arm was stopped" not in running.text and "failed to terminate" not in running.text
    assert running.text.count("process has finished cleanly") == 2


def test_a_launch_that_was_killed_leaves_an_arm_at_rest(peer: Peer, moving: tuple[Launched, FakeArm]) -> None:
    running, arm = moving
    running.process.kill()
    peer.until("the end", lambda: ended(running), arm)
    assert fastest(peer)[-1] == 0.0


def test_the_watchdog_stops_the_arm_of_a_killed_node_and_ends(peer: Peer, moving: tuple[Launched, FakeArm]) -> None:
    running, arm = moving
    os.kill(pid_of(running, "ik_node"), signal.SIGKILL)
    peer.until("the end", lambda: ended(running), arm)
    assert fastest(peer)[-1] == 0.0
    assert "no command for 5 s after a non-zero one; the arm was stopped" in running.text


def pid_of(running: Launched, executable: str) -> int:
    started = re.search(rf"\[{executable}-\d+\]: process started with pid \[(\d+)\]", running.text)
    assert started is not None
    return int(started.group(1))


def test_a_node_that_cannot_be_configured_ends_the_launch(prefix: Path, tmp_path: Path) -> None:
    urdf = tmp_path / "arm.urdf"
    urdf.write_text("no URDF")
    with own_domain() as domain:
        running = Launched(prefix, tmp_path / "launch.log", [f"urdf:={urdf}"], domain)
        wait_until(lambda: running.process.poll() is not None)
    assert "not configured: " in running.text and "Traceback" not in running.text
