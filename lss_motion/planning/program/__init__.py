"""Compiles a trajectory into a program: which bytes leave on which bus at which instant.

  file       what it is                                              who calls it
  compile    trajectory → program: choice of drives, schedule,       api, shows, player.session
             verification, errors
  splice     extensions of a program that is being played            walking, live_edit
  live_edit  the rest of a show that is edited while it plays        studio
  drives     timed, streamed, stepped: one interface; `drive: auto`  schedule, compile
  mates      servos of one joint get the same moves together         schedule, compile
  schedule   all joints fitted on the lines that they share          compile, splice
  line       slots on one serial line, and their check               schedule, compile
  fit        timed moves of all joints, segment by segment           schedule, drives
  given      segments whose commands the author gives                fit
  segments   cuts references at the stops of a servo                 fit
  search     the next timed move: travel speed and length            fit
  cones      travel speeds that keep a profile near its reference    search, fit
  moves      fitted moves as arrays, and the profiles they make      fit, schedule, verify
  streamed   bare `D`: through the filter of EM0, or whole degrees   drives, verify, player
  response   the model of a servo in EM1, for one and for many       all of the above, player
  reference_grid
             what profiles should do, on a grid; limits of servos    all of the above, player
  move_table the moves of a program in arrays                        schedule, verify, compile
  verify     motion of the compiled bytes against every limit        compile, shows, player, studio
  accuracy   how far the horns of a program may be from the plan     compile
  model      the program as a value                                  all packages above this one
  text       the program as a file                                   cli
  arduino    the program as an Arduino sketch                        cli

Angles in this package are servo angles in degrees, unless a name says `joint`; instants are show
time. A *reference* is what a profile should do, a *profile* what the response model of a servo
makes of the commands that it receives.
"""
