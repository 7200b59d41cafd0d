"""A bus judged by listening to it: counters of its stations and masters, verdicts with reasons, the report of it.

- ``clock``: The time that a class 3 master sends, as it is heard: intervals, jitter, and its Clock_Values
- ``counters``: Counters of stations, masters and the bus, from the transmissions on a line
- ``devices``: The devices of a bus as far as configuration and GSD files describe them: names, models, diagnosis texts,
  T_SDR
- ``drawings``: Histograms, time line and schedule of the report as SVG
- ``evidence``: Evidence that the telegrams on a line are PROFIBUS and not another protocol of the same form
- ``exchanges``: Transmissions of a bus in columns, without loss: each Data_Exchange with its answer is a row, every
  other one too
- ``history``: The past of each station, second by second and minute by minute, in a few numbers: bursts, failures at
  once, T_SDR
- ``markup``: HTML of what is printed: the acceptance report and the commissioning sheet
- ``monitor``: A bus judged by listening: transmissions in, events and a summary with verdicts out. No clock, memory
  bounded
- ``not_heard``: Things of a bus that nobody can know who only listens, as no telegram of the time of listening carried
  them
- ``report``: The acceptance report of a bus: one HTML file that a customer reads, prints and signs
- ``run_sections``: Sections of the report of a run on what its master knows beside the octets: modules, standing
  diagnoses, I&M0
- ``schedule``: The schedule of one rotation, from a bounded record
- ``summary``: The summary of a monitored bus as plain data: the last JSON line of ``dpstack monitor``, and the report's
  figures
- ``thresholds``: Thresholds of the verdicts, each with its unit, its meaning and its source
- ``timing``: Figures of durations as far as the source of the octets can time them; None stands for those that it
  cannot
- ``triggers``: Triggers of a capture, and the window around them: keeps what mattered, in bounded memory
- ``verdict``: ``Verdict``: a level with reasons, of a bus that is listened to, and of one that runs
- ``verdicts``: Verdicts on stations and on the bus: good, warning, critical or unknown, with reasons in a maintainer's
  words
"""
