"""The single checks of admission; each raises :class:`~s2r_executor.plan.CommandRefusedError` and changes nothing."""
