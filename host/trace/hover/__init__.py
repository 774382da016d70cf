"""What changed between two sets of flights, from the balance of forces and torques in hover.

For logs that hold motor commands but no body rate: hover and gentle flight at motor level. In the mean of a
flight the rotors carry the weight and balance every torque, whatever the controller does. So the mean
commands of the four rotors give four numbers for each log, and a change of mass, centre of mass, one rotor or
a constant torque shows in them. No part of the motion is predicted.

- `mean`: the mean thrust of each rotor in a log, and how sure it is.
- `balance`: accelerations that the model predicts from it, and their slopes.
- `fit`: sets of effects fitted to the difference between the sets of flights.
- `compare`: the result as a trace.
"""
