"""The speed up to which a contact does not rebound, for kernels and for messages about a scene.

A contact that nothing supports gains the closing speed a dt in a step, where a is the acceleration that presses its
pair together; if both bodies accelerate towards each other by a, it gains 2 a dt. With exact times of impact,
velocities at an impact follow from the accelerations alone, so a supported contact seems to close at up to ½ a dt,
which is 2 a dt times `SLOW` in `carom.physics.contact.events.event_loop`.
"""

PER_STEP = 2.0  # rest speed in units of a dt
