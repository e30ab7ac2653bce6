"""Sound: reading files, and playing them on a clock that can be read. Extra `[sound]`.

Nothing here knows a robot or a show; the packages above hand over times and files. Without the
extra every module can be imported; what needs it raises `InputError` with the command that
installs it.

| file       | what it does                                          | used by                    |
|------------|-------------------------------------------------------|----------------------------|
| `files.py` | WAV, FLAC, OGG and MP3 as samples, exact to the frame | `sequence`, `interchange`  |
"""
