"""Which messages of a Step the node publishes."""

from __future__ import annotations

from made_steps import made_step, panda
from ros_peer import Peer, peer_in_own_domain

from ik_node.messages import encode
from ik_node.messages.step_outputs import STEP_TOPICS
from ik_node.ros import qos
from ik_node.ros.publisher import MESSAGE_TYPES, StepPublisher
from ik_node.settings.groups import Settings


def topics_of(publisher: StepPublisher, is_recorded: bool) -> list[str]:
    return [message.topic for message in publisher.publish_step(made_step(4, 7), is_recorded)]


def test_a_step_goes_to_topics_with_a_subscriber_and_into_a_recording() -> None:
    with peer_in_own_domain() as peer:
        publisher = StepPublisher(peer.node)
        publisher.configure(panda(), Settings())
        assert topics_of(publisher, False) == [encode.COMMANDS]
        assert topics_of(publisher, True) == [encode.COMMANDS, *STEP_TOPICS]
        for topic in STEP_TOPICS:
            assert_published_while_subscribed(peer, publisher, topic)


def assert_published_while_subscribed(peer: Peer, publisher: StepPublisher, topic: str) -> None:
    received: list[bytes] = []

    def publish() -> None:
        publisher.publish_step(made_step(4, 7), False)

    subscription = peer.node.create_subscription(
        MESSAGE_TYPES[topic], publisher.topics[topic], received.append, qos.OUTPUT, raw=True
    )
    peer.until(f"a message on {topic}", lambda: bool(received), each=publish)
    assert topics_of(publisher, False) == [encode.COMMANDS, topic]
    peer.node.destroy_subscription(subscription)
    peer.until(f"the end of {topic}", lambda: topics_of(publisher, False) == [encode.COMMANDS])
