"""The real-time core without I/O: what to send now, what to ask, how to correct, when to stop.

player        one show, as others see it · phases  what comes after what · session  what they share
setup, settling  before and after the show · events  what happened
watch         what is wrong · troubles, ladder, recovery  what is done about it
agenda        marks and cues: what comes at its time and is not motion
streamer      one program on the show clock · track, following  one joint meanwhile
catching_up   how a timed joint gets back to its plan
setpoints, leading  what a joint in EM0 may be told, and how it is led back to its program
line, queries, turnaround, readings, dialogue, conversation  what goes over a line and what it means
"""
