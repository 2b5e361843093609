"""SRDFs: their sources, the pairs that they disable, and the errors of invalid ones. test_collision.py tests the use of
the pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ik_node.collision import geometry as collision_geometry
from ik_node.collision import pair_selection
from ik_node.control.controller import Controller
from ik_node.errors import SettingsError
from ik_node.robot import catalogue, srdf
from ik_node.settings.groups import ArmSettings, ObstacleSettings, Settings

TEXT = """<?xml version="1.0" encoding="UTF-8"?>
<robot name="panda"><disable_collisions link1="panda_link5" link2="panda_link7" reason="Default"/></robot>"""
PANDA = ArmSettings(robot="panda")


def test_text_file_and_shipped_are_equivalent(tmp_path: Path) -> None:
    """The SRDF of the panda in three ways gives the same pairs, and the settings contain the text, not the path."""
    shipped = srdf.shipped(PANDA)
    assert shipped.name == "panda.srdf"
    copy = tmp_path / "mine.srdf"
    copy.write_text(shipped.read_text())
    robot = catalogue.robot_from_settings(PANDA)
    digests = set()
    for wanted in (shipped.read_text(), str(copy), "shipped"):
        controller = Controller(robot, Settings(arm=PANDA, obstacles=ObstacleSettings(srdf=wanted)))
        assert controller.settings.obstacles.srdf == shipped.read_text()
        digests.add(controller.collision_monitor.digest)
        assert "disabled by the SRDF: " in controller.collision_monitor.pairs
    assert len(digests) == 1
    assert Controller(robot, Settings(arm=PANDA)).collision_monitor.digest not in digests


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7", "talos_arm", "kinova", "z1"])
def test_shipped_ones_fit_their_arms(name: str) -> None:
    """No checked pair is in permanent contact, which would block the arm; those of kinova and z1 disable no pair."""
    arm = ArmSettings(robot=name)
    robot, text = catalogue.robot_from_settings(arm), srdf.read_srdf("shipped", arm)
    geometry = collision_geometry.load(robot, srdf=text)
    links = geometry.names()
    disabled = {
        frozenset((pair.first, pair.second)) for pair in geometry.pairs if pair.reason == "disabled by the SRDF"
    }
    assert disabled <= srdf.disabled_pairs(text, links)
    assert bool(disabled) == (name not in ("kinova", "z1"))
    distances = pair_selection.sampled_distances(robot, geometry.links, geometry.watched())
    assert distances.shape[1] > 5
    assert (np.mean(distances <= 0.0, axis=0) < pair_selection.PERMANENT_CONTACT).all()


def test_pairs_disabled_by_default_and_enabled_again() -> None:
    text = """<robot name="r"><disable_default_collisions link="a"/><enable_collisions link1="b" link2="a"/>
    <disable_collisions link1="d" link2="c" reason="Never"/></robot>"""
    found = srdf.disabled_pairs(text, ("a", "b", "c", "d"))
    assert found == {frozenset("ac"), frozenset("ad"), frozenset("cd")}
    assert srdf.disabled_pairs(TEXT, ()) == {frozenset(("panda_link5", "panda_link7"))}


@pytest.mark.parametrize(
    ("wanted", "arm", "words"),
    [
        (
            "nowhere.srdf",
            PANDA,
            "nowhere.srdf: No such file or directory; valid: SRDF text, the path of a file, shipped",
        ),
        ("<robot", PANDA, "not XML"),
        ("shipped", ArmSettings(), "set `robot`"),
        ("shipped", ArmSettings(robot="pandora"), "unknown robot 'pandora'"),
        (
            "shipped",
            ArmSettings(robot="ur10"),
            "no SRDF for 'ur10'; in its folder: ur_description/srdf/ur3_gripper.srdf",
        ),
    ],
)
def test_invalid_sources_are_refused(wanted: str, arm: ArmSettings, words: str) -> None:
    with pytest.raises(SettingsError, match=r"obstacles\.srdf|example-robot-data") as caught:
        srdf.read_srdf(wanted, arm)
    assert words in str(caught.value)


def test_a_folder_is_no_srdf(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        srdf.read_srdf(str(tmp_path), PANDA)


@pytest.mark.parametrize("encoding", ["utf-6", "utf-16", "latin-1"])
def test_the_declared_encoding_of_a_text_does_not_apply(encoding: str) -> None:
    text = f"<?xml version='1.0' encoding='{encoding}'?><robot><disable_collisions link1='ä' link2='b'/></robot>"
    assert srdf.read_srdf(text, ArmSettings()) == text
    assert srdf.disabled_pairs(text, ()) == {frozenset(("ä", "b"))}


@pytest.mark.parametrize("source", ["/dev/zero", "a\0b", "<robot>\ud800", "<robot/>\x00"])
def test_a_source_of_any_content_is_refused(source: str) -> None:
    with pytest.raises(SettingsError, match=r"obstacles\.srdf"):
        srdf.read_srdf(source, ArmSettings())
