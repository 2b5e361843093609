"""Controller calls from messages, live and recorded.

``call_table`` is the table from topic to decoder to controller method. ``recorded_controller`` makes the calls and
records them; the node and the simulated runs use it. A ``call_source`` (a recording, or an ``external_bag``) yields
recorded calls:

- ``bitwise`` makes them on a new controller and compares every Step with the recorded one;
- ``closed_loop`` replaces the joint states by those of a simulated arm, so that other settings can be tried
  (``what_if`` compares such runs by their metrics, ``rerecord`` records one, ``side_by_side`` reports on several);
- ``ros.bag_player`` publishes their messages to a running node.

``text`` prints the results.
"""
