"""Which publisher of a topic is heard, when there are two."""

import pytest

from ptnsbc_nodes.comm.senders.first import SILENT_S, FirstSender, Yields

OURS, THEIRS, THIRD = b"ours", b"theirs", b"third"


class Air:
    """The publishers that the graph shows, and a clock."""

    def __init__(self, **names):
        self.names = {gid.encode(): name for gid, name in names.items()}
        self.now_s = 100.0
        self.looks = 0

    def graph(self):
        self.looks += 1
        return dict(self.names)

    def first(self, yields=Yields.SILENT, any_node=False, by_numbers=False):
        return FirstSender(yields, self.graph, any_node, by_numbers, lambda: self.now_s)


def objection(sender, gid):
    """To a message whose number nothing is known about."""
    return sender.objection(gid, 0)


def is_heard(sender, gid):
    return not objection(sender, gid)


@pytest.mark.parametrize("yields", Yields)
def test_the_first_is_kept_and_the_second_refused_and_named(yields):
    air = Air(ours="/uav1")
    sender = air.first(yields)
    assert is_heard(sender, OURS)
    air.names[THEIRS] = "/outsider"
    for _ in range(30):
        air.now_s += 0.1
        assert objection(sender, THEIRS) == "is from a second publisher: /outsider"
        assert is_heard(sender, OURS)
    air.now_s += 60.0  # it is silent: to another node it does not give way
    assert not is_heard(sender, THEIRS)
    assert sender.others() == ["/outsider"]


@pytest.mark.parametrize("yields", Yields)
def test_a_publisher_that_the_graph_knew_before_any_message_is_the_first(yields):
    air = Air(ours="/uav1")
    sender = air.first(yields)
    assert sender.others() == []
    air.names[THEIRS] = "/outsider"
    assert not is_heard(sender, THEIRS)
    assert is_heard(sender, OURS)


@pytest.mark.parametrize("yields", Yields)
def test_who_ends_makes_room_for_the_next_of_its_node(yields):
    air = Air(ours="/uav1")
    sender = air.first(yields)
    assert is_heard(sender, OURS)
    air.names = {THEIRS: "/outsider", THIRD: "/uav1"}
    assert is_heard(sender, THIRD)
    assert not is_heard(sender, THEIRS)


@pytest.mark.parametrize("any_node", [False, True])
@pytest.mark.parametrize("yields", Yields)
def test_an_outsider_takes_the_place_of_one_that_has_ended_only_where_any_node_may(
    yields, any_node
):
    """At the end of a flight the bag had the states of the outsider, once the sim was gone."""
    air = Air(ours="/sim", theirs="/outsider")
    sender = air.first(yields, any_node)
    assert is_heard(sender, OURS)
    assert not is_heard(sender, THEIRS)
    del air.names[OURS]
    air.now_s += 60.0
    assert is_heard(sender, THEIRS) is any_node
    assert sender.others() == ([] if any_node else ["/outsider"])
    air.names[THIRD] = "/sim"
    assert is_heard(sender, THIRD) is not any_node


def test_a_process_that_was_killed_and_started_again_is_heard_before_the_graph_forgets_the_dead_one():
    air = Air(ours="/uav1", third="/uav1")
    sender = air.first()
    assert is_heard(sender, OURS)
    air.now_s += SILENT_S
    assert not is_heard(sender, THIRD)
    air.now_s += 0.01
    assert is_heard(sender, THIRD)
    assert not is_heard(sender, OURS)  # it only slept


def test_a_publisher_that_has_never_been_heard_gives_way_to_one_of_its_node():
    air = Air(ours="/uav1", theirs="/outsider", third="/uav1")
    sender = air.first()
    assert sender.others() == ["/outsider", "/uav1"]
    assert not is_heard(sender, THEIRS)
    assert is_heard(sender, THIRD)
    assert not is_heard(sender, OURS)


@pytest.mark.parametrize("yields", [Yields.AT_ONCE, Yields.UNNAMED])
def test_where_silence_tells_nothing_one_of_the_same_node_is_heard_at_once(yields):
    air = Air(ours="/uav1", third="/uav1")
    sender = air.first(yields)
    assert is_heard(sender, OURS)
    assert is_heard(sender, THIRD)


@pytest.mark.parametrize(("yields", "heard"), [(Yields.AT_ONCE, False), (Yields.UNNAMED, True)])
def test_a_second_publisher_whose_node_is_unknown_yet(yields, heard):
    air = Air(ours="/uav1")
    sender = air.first(yields)
    assert is_heard(sender, OURS)
    air.names[THIRD] = ""
    assert is_heard(sender, THIRD) is heard
    air.now_s += 0.2
    air.names[THIRD] = "/outsider"
    air.names[THEIRS] = "/outsider"
    assert is_heard(sender, THEIRS) is heard  # of the node of the one that is kept by now
    assert is_heard(sender, OURS) is not heard


def test_a_message_that_comes_before_the_graph_has_its_publisher():
    air = Air()
    sender = air.first()
    assert is_heard(sender, OURS)
    air.names[THEIRS] = "/outsider"
    assert not is_heard(sender, THEIRS)
    air.names[OURS] = "/uav1"
    assert is_heard(sender, OURS)


def test_a_flood_does_not_ask_for_the_graph_with_every_message():
    air = Air(ours="/uav1", theirs="/outsider")
    sender = air.first()
    for _ in range(1000):
        air.now_s += 0.001
        assert is_heard(sender, OURS)
        assert not is_heard(sender, THEIRS)
    assert air.looks < 15


UNKNOWN = b""


def test_a_message_without_a_gid_is_of_the_publisher_whose_numbers_it_continues():
    air = Air(ours="/uav1", theirs="/outsider")
    sender = air.first()
    assert not sender.objection(OURS, 500)
    assert sender.objection(THEIRS, 20)
    assert not sender.objection(UNKNOWN, 501)
    assert sender.objection(UNKNOWN, 21)
    assert not sender.objection(UNKNOWN, 504), "two are lost"
    assert sender.objection(UNKNOWN, 3), "of a third one"
    assert sender.objection(UNKNOWN, 9000)
    assert not sender.objection(OURS, 505)


def test_numbers_that_run_through_those_of_the_first_are_told_apart():
    """An outsider sends ten times as often; every message but each fifth comes with a GID."""
    air = Air(ours="/uav1", theirs="/outsider")
    sender = air.first()
    mistaken = 0
    for ours in range(1, 400):
        for k in range(10):
            theirs = 10 * (ours - 300) + k
            if theirs > 0:
                gid = UNKNOWN if theirs % 5 == 0 else THEIRS
                mistaken += not sender.objection(gid, theirs)
        mistaken += bool(sender.objection(UNKNOWN if ours % 5 == 0 else OURS, ours))
    assert mistaken <= 2


def test_without_a_second_publisher_every_message_without_a_gid_is_taken():
    air = Air(ours="/uav1")
    sender = air.first()
    for number in (1, 2, 500, 3):
        air.now_s += 0.2
        assert not sender.objection(UNKNOWN, number)
    sender = Air().first()
    assert not sender.objection(UNKNOWN, 1), "before the graph has its publisher"
    assert not sender.objection(OURS, 2)


def test_in_lockstep_no_message_without_a_gid_is_lost():
    air = Air(ours="/uav1", theirs="/outsider")
    sender = air.first(Yields.UNNAMED)
    assert not sender.objection(OURS, 500)
    assert sender.objection(THEIRS, 20)
    assert sender.objection(UNKNOWN, 21)
    assert not sender.objection(UNKNOWN, 1)


def alone(air, **options):
    """A first publisher whose numbers are enough, after its message 150."""
    sender = air.first(by_numbers=True, **options)
    alone_at = next(n for n in range(1, 200) if not sender.objection(OURS, n) and sender.is_alone())
    assert alone_at == 100
    for number in range(101, 151):
        assert sender.follows(number)
    return sender


def test_while_the_first_is_alone_its_numbers_are_enough():
    air = Air(ours="/uav1")
    sender = alone(air)
    looks = air.looks
    assert sender.follows(160)  # nine are lost
    assert not sender.follows(160)
    assert not sender.follows(3)
    assert not sender.follows(161 + 100)  # no network loses so many in a row
    assert sender.follows(161)
    assert air.looks == looks


def test_lost_messages_of_the_first_are_counted_by_whatever_tells_it_apart():
    air = Air(ours="/uav1")
    sender = air.first(by_numbers=True)
    for number in (40, 41, 44):  # what it sent before it was heard is not lost
        assert not sender.objection(OURS, number)
    assert sender.lost == 2
    newest = next(n for n in range(45, 200) if not sender.objection(OURS, n) and sender.is_alone())
    assert sender.follows(newest + 1)
    assert sender.follows(newest + 4)
    assert sender.lost == 4
    assert not sender.follows(newest + 204)  # too many: the GID decides
    assert not sender.objection(OURS, newest + 204)
    assert sender.lost == 4 + 199
    air.names[THEIRS] = "/outsider"
    assert sender.objection(THEIRS, 7)
    assert sender.objection(THEIRS, 9)
    assert not sender.objection(OURS, newest + 205)
    assert sender.lost == 203


def test_a_restarted_publisher_counts_anew():
    air = Air(ours="/uav1")
    sender = alone(air)
    air.names[THIRD] = "/uav1"
    air.now_s += 10.0
    assert not sender.follows(3)
    assert not sender.objection(THIRD, 3)
    assert not sender.objection(THIRD, 5)
    assert sender.lost == 1


def test_a_second_publisher_is_noticed_by_its_first_number_and_refused_by_its_gid():
    air = Air(ours="/uav1")
    sender = alone(air)
    air.names[THEIRS] = "/outsider"
    assert not sender.follows(1)
    assert "second publisher" in sender.objection(b"", 1)  # it came without its GID
    assert "/outsider" in sender.objection(THEIRS, 2)
    for number in range(151, 300):
        assert not sender.objection(OURS, number)
        assert not sender.is_alone()
    del air.names[THEIRS]
    heard = [sender.objection(OURS, n) == "" and sender.is_alone() for n in range(300, 450)]
    assert any(heard)


def test_one_that_was_heard_by_its_numbers_has_not_been_silent():
    air = Air(ours="/uav1")
    sender = alone(air)
    air.now_s += 10.0
    assert sender.follows(151)
    air.names[THIRD] = "/uav1"  # of a node with the same name
    assert not sender.follows(1)
    assert "second publisher" in sender.objection(THIRD, 1)
    assert not sender.objection(OURS, 152)


def test_rare_messages_are_judged_by_their_gids():
    air = Air(ours="/uav1")
    sender = air.first()
    assert not any(not sender.objection(OURS, n) and sender.is_alone() for n in range(1, 300))
