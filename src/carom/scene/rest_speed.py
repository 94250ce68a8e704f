"""The speed up to which a contact does not rebound, for kernels and for messages about a scene.

A contact that nothing holds closes by a dt in a step, where a is the acceleration that presses its pair together; if
both bodies accelerate towards each other by a, it closes by 2 a dt. With exact times of impact, `SLOW` of
`carom.physics.contact.events.event_loop` times 2 a dt is ½ a dt: velocities at the time of an impact follow from the
accelerations alone, so a contact that is held seems to close by up to that.
"""

PER_STEP = 2.0  # of a dt
