"""The executor of the nodes: whatever rclpy's own handles, and nothing twice or never."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from graphs import RELIABLE
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from ros_insdvl.process.executor import NodeExecutor


class Pair:
    """Two nodes of one context, and the executor that turns them."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.executor = NodeExecutor(context=self.context)
        self.nodes = [Node(name, context=self.context) for name in ("one", "two")]
        for node in self.nodes:
            self.executor.add_node(node)

    def until(self, condition: Callable[[], Any]) -> None:
        for _ in range(100_000):
            if condition():
                return
            self.executor.spin_once(0.05)
        raise AssertionError("it did not happen")

    def idle(self, seconds: float = 0.2) -> None:
        """Turn until nothing is ready any more."""
        ended = self.executor.create_task(lambda: None)
        self.until(ended.done)
        for _ in range(10):
            self.executor.spin_once(seconds / 10)

    def close(self) -> None:
        self.executor.let_go()
        for node in self.nodes:
            node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()


@pytest.fixture
def pair(managed: Any) -> Iterator[Pair]:
    yield managed(Pair())


def sent_and_heard(pair: Pair, handle: Callable[[Int32], None]) -> Any:
    """A publisher whose messages the other node handles."""
    one, two = pair.nodes
    publisher = one.create_publisher(Int32, "numbers", RELIABLE)
    two.create_subscription(Int32, "numbers", handle, RELIABLE)
    pair.until(lambda: publisher.get_subscription_count() == 1)
    return publisher


def test_each_message_is_handled_once_and_in_order(pair: Pair) -> None:
    heard: list[int] = []
    publisher = sent_and_heard(pair, lambda message: heard.append(message.data))
    for k in range(300):
        publisher.publish(Int32(data=k))
    pair.until(lambda: len(heard) >= 300)
    pair.idle()
    assert heard == [*range(300)]


def test_timers_services_guards_and_tasks_are_handled(pair: Pair) -> None:
    one, two = pair.nodes
    counts = {"timer": 0, "guard": 0, "task": 0, "other task": 0}

    def count(name: str) -> None:
        counts[name] += 1

    timer = one.create_timer(0.001, lambda: count("timer"))
    pair.until(lambda: counts["timer"] >= 3)
    timer.cancel()
    guard = one.create_guard_condition(lambda: count("guard"))
    guard.trigger()
    pair.until(lambda: counts["guard"])
    for name in ("task", "other task"):  # one wake for both
        pair.executor.create_task(lambda name=name: count(name))
    pair.until(lambda: counts["task"] and counts["other task"])
    two.create_service(Trigger, "ask", lambda request, response: response)
    client = one.create_client(Trigger, "ask")
    pair.until(client.service_is_ready)
    answer = client.call_async(Trigger.Request())
    pair.until(answer.done)
    counts["timer"] = 0
    pair.idle()
    assert counts == {"timer": 0, "guard": 1, "task": 1, "other task": 1}


def test_what_other_threads_make_and_trigger_is_heard(pair: Pair) -> None:
    ticks: list[int] = []

    def make() -> None:
        pair.nodes[0].create_timer(0.001, lambda: ticks.append(1))

    thread = threading.Timer(0.05, make)
    thread.start()
    while not ticks:
        pair.executor.spin_once()  # without a limit: only the new timer ends it
    thread.join()


def test_a_callback_may_end_and_begin_subscriptions(pair: Pair) -> None:
    heard: list[int] = []
    two = pair.nodes[1]

    def once(message: Int32) -> None:
        heard.append(message.data)
        two.destroy_subscription(subscription)
        two.create_subscription(Int32, "others", lambda m: heard.append(-m.data), RELIABLE)

    publisher = sent_and_heard(pair, lambda message: None)
    others = pair.nodes[0].create_publisher(Int32, "others", RELIABLE)
    subscription = two.create_subscription(Int32, "numbers", once, RELIABLE)
    pair.until(lambda: publisher.get_subscription_count() == 2)
    for k in (1, 2, 3):
        publisher.publish(Int32(data=k))
    pair.until(lambda: others.get_subscription_count() == 1)
    others.publish(Int32(data=7))
    pair.until(lambda: len(heard) == 2)
    assert heard == [1, -7]
    pair.until(lambda: publisher.get_subscription_count() == 1)


def test_an_error_of_a_callback_costs_nobody_else_a_message(pair: Pair) -> None:
    heard: list[int] = []

    def handle(message: Int32) -> None:
        heard.append(message.data)
        if message.data % 2:
            raise ValueError(message.data)

    publisher = sent_and_heard(pair, handle)
    task = pair.executor.create_task(lambda: heard.append(-1))
    for k in range(6):
        publisher.publish(Int32(data=k))
    errors: list[int] = []
    while not task.done() or len(heard) < 7:
        try:
            pair.executor.spin_once(0.05)
        except ValueError as error:
            errors.append(error.args[0])
    assert errors == [1, 3, 5]
    assert sorted(heard) == [-1, 0, 1, 2, 3, 4, 5]


def test_a_shutdown_from_another_thread_ends_a_wait_without_limit(pair: Pair) -> None:
    thread = threading.Timer(0.1, pair.context.try_shutdown)
    thread.start()
    with pytest.raises(ExternalShutdownException):
        while True:
            pair.executor.spin_once()
    thread.join()


def test_a_node_that_was_removed_is_not_turned(pair: Pair) -> None:
    heard: list[int] = []
    publisher = sent_and_heard(pair, lambda message: heard.append(message.data))
    pair.executor.remove_node(pair.nodes[1])
    publisher.publish(Int32(data=1))
    pair.idle()
    assert heard == []
    pair.executor.add_node(pair.nodes[1])
    pair.until(lambda: heard == [1])


class Never(MutuallyExclusiveCallbackGroup):
    """A group whose callbacks nobody is to call."""

    def can_execute(self, entity: Any) -> bool:
        return False


def test_a_subscription_that_its_group_holds_back_keeps_its_messages(pair: Pair) -> None:
    heard: list[int] = []
    one, two = pair.nodes
    publisher = one.create_publisher(Int32, "numbers", RELIABLE)
    subscription = two.create_subscription(
        Int32, "numbers", lambda message: heard.append(1), RELIABLE, callback_group=Never()
    )
    pair.until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(Int32(data=5))
    pair.idle()
    assert heard == []
    with subscription.handle:
        assert subscription.handle.take_message(Int32, False)[0].data == 5
