"""Sound: reading and analysing files, playing them on a clock that can be read. Extra `[sound]`.

Nothing here knows a robot or a show; the packages above hand over times and files. Without the
extra every module can be imported; what needs it raises `InputError` with the command that
installs it.

| file              | what it does                                         | used by              |
|-------------------|------------------------------------------------------|----------------------|
| `files.py`        | WAV, FLAC, OGG, MP3 as samples and spectra           | all                  |
| `mixer.py`        | what a device plays, block by block, with the show   | `device`             |
| `envelope.py`     | loudness over time; syllables, swells, sides; drawn  | `interchange`, `cli` |
| `beats.py`        | tempo and beats, as a proposal                       | `cli`                |
| `device.py`       | the devices; the process that plays the sounds of a show | `playing`, `cli` |
"""
