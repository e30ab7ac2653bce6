"""Plays a program on the servos of a robot, without I/O.

The package does no input or output: it has no port, no thread and no clock. A driver
(`playing.runner`, or a test in virtual time) calls four functions of `Player` and does the I/O
itself:

    data_to_send(leaves_ns)          bytes to write now; they leave at `leaves_ns`
    receive_data(bus, data, now_ns)  bytes that a port delivered
    next_wakeup_ns()                 latest instant of the next call
    next_event()                     what happened, as a value of `events`

All instants are integer nanoseconds on the driver's run clock, and must not decrease. The same
calls with the same arguments give the same bytes, so a log can be replayed (`playing.replay`).

    file            what it is                                          who calls it
    player          the calls of the loop and of those that steer       run, live, walking, cli
    phases          the phases of a run, and every change of them       player
    added_show      what is played beside it, on other joints           phases
    repertoire      the programs of a run, and the present show         player, phases
    session         the servos during one run, shared by all phases     phases
    preflight       the dialogue before servos move, also once more     session, hands_on, cli
    checks          what the servos answered, compared with the files   session, preflight, cli
    handshake       dialogues: settings, restore, recovery              session, connection, cli
    streamer        one program on the show clock                       session
    show_clock      show time, the moves due on it, how late they are   streamer, cues, report
    following       keeps a show in step with a leader                  remote, stage, cli
    rate_ramps      moves computed at run time: other rates, off plan   streamer
    servo_model     moves and settings that a servo has; its filter     joint_state, hands_on
    joint_state     one joint: sent moves, model, readings              streamer, polling
    estimators      load, play, lag, lost moves of a joint              joint_state
    standing        corrections of a joint at rest                      joint_state
    polling         queries in the gaps between moves, and their use    streamer
    query_choice    which servo is polled next, and for what            polling
    query_tracker   one line, and the queries in flight on it           all that send
    twins           whether two servos answer to one id                 query_tracker
    echo            what an adapter returns of what was sent to it      query_tracker, checks
    unasked         what arrives on a bus beyond its queries            session, monitor
    health          faults found in answers and in missing answers      polling
    faults          steps that are taken about faults                   player
    cues            marks, cues, and waits for sensors                  session, streamer
    events          what happened, as values                            player, run, cli
"""
