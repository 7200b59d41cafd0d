"""Builders and helpers of tests in more than one folder. This folder is on the path: ``from bus_kit import SimBus``.

If only the tests of one folder use a helper, it stands beside them: ``from tests.drives.keb_kit import sim``.

Packages, each with a map of its own:

- ``faults``: the fault matrix, and devices that misbehave. Plants with one fault each, for diagnoses: tests/why
  (``fault_table`` on ``fault_plants``, with ``fault_proofs`` and ``fault_score``).
- ``ends``: programs that end a bus in every way, and the last telegrams to a slave.
- ``soak``: endurance runs.
- ``stories``: machines by seed, as lines of snapshots. ``texts``: texts, tables and transcripts, also.

Buses, all in virtual time:

- ``support``: worlds with a referee (fixtures ``world`` and ``w``), the decoded wire log, dummy stations.
- ``bus_kit``: a station in a world (``add_station``), a master with mirror slaves (``SimBus``). On it: ``planned_bus``
  (undisturbed rounds), ``fire_kit`` (token ring of several masters), ``report_kit`` (a bus that is listened to).
- ``changed_traffic``: what a listener hears of a small bus, with changes that hypothesis makes.
- ``adapter_model``: a station behind a USB serial adapter: delay and packing of octets.
- ``wire_truth``: the world's own account of a bus, for counters of listening stations.
- ``ring_bus``: a wire of literal octets without ``World``; slaves are functions from octets to octets. On it:
  ``order_bus`` (a station with acyclic services, orders and their ends), and on that ``class2_kit``, ``ms1_kit``,
  ``alarm_kit`` (with a DP master), ``ms2_kit``.
- ``scripted_link``: a DP master without link layer, its slaves answer by script.
- ``api_kit``: configured slaves, buses of the public API and slaves of the program in virtual time; ``virtual_kit``:
  the loop of virtual time; ``rack_kit``: a rack of modules with a diagnosis.
- ``process_kit``: buses of the public API on a pty, with either driver.

One end alone, the other in literal octets:

- ``octet_slave``: DP slave as a function of octets, and SD1 and SD2 by hand. ``octet_wire``: a line to one slave of
  dpstack. On it: ``octet_class2`` (master of class 2), ``simulated_kit`` (slaves of a configuration).
- ``waveforms``: levels of a line bit by bit, and files of logic analysers.
- ``slave_kit``: requests to the DP slave as telegrams, a device that records its calls; on it ``slave_alarm_kit``.
- ``foreign_master``: a master that is not ours in a world.
- ``support_responder``: slaves of octets as a program, also for the benchmarks; ``recordings``: octets of real
  devices; ``ft12``: telegrams of M-Bus and IEC 101.

Drivers, ports, programs:

- ``memory_port``: two ports joined in memory; ``kernel_kit``: drivers on a clock and a line of the test;
  ``far_ends``: other ends of ports, and waits for what happens there; ``fake_adapter``: serial driver and sysfs in
  memory; ``baud_rig``: traffic behind a UART.
- ``plant_files``: configuration files of buses and slaves.
- ``programs``: ``dpstack`` as a program, ``forked_programs``: as a fork of one that has imported it; ``control_kit``:
  control sockets and a client of octets; ``cli_kit``: commands in the process of the test.
- ``pa_kit``: a process device of PROFIBUS PA in records of octets.
- ``pa_gateway``: parameters of PROFIBUS PA devices for programs of others, over UDP; ``pa_walkers``: three of those;
  ``pa_rack``: the simulated devices that they read.

Drives: ``drive_bench`` (plugin and simulated drive), on it ``demag_kit``; ``profidrive_kit`` (a drive without
peculiarities); ``acyclic_kit`` (record 47).

Connectors of a bus to other programs:

- ``plant_items``: items of the live stream of a plant, for trees and connectors; ``probe_connector``: a connector for
tests.
- Sparkplug B: ``edge_node_rig`` (an edge node in virtual time), ``history_rig`` (with store and forward),
  ``sparkplug_host`` (a host that knows only the specification), ``fake_broker`` (a broker of MQTT 5); ``fleet_kit``
  (statuses of segments).
- ``opcua_rig``: a server of OPC UA and its clients; ``metrics_kit``: scrapes of metrics;
  ``prometheus_expressions``: those of the alert rules and of the dashboards.
- ``verdicts_kit``: the verdicts on a slave of literal items. ``page_kit``: an HTML page taken apart; ``tls_kit``:
  certificates and keys.

Lists and snapshots, each also a program: ``wire_logs`` (scenarios with fixed seeds), ``public_names`` (signatures),
``promises`` (of the security page, with their tests), ``pictures_kit`` (pictures of README and docs; no program).

Others: ``gsd_kit`` (GSD files), ``step7_kit`` (exports of STEP 7), ``linear_kit`` (linear time and memory),
``property_kit`` (number of examples of hypothesis), ``lost_errors`` (errors of tasks that nobody has asked for).

The processes of ``make test``: ``file_scheduling`` (the order of files), ``shared_compilation`` (on a new checkout).
"""
