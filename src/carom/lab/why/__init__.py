"""Why a body moves as it does: the impacts, contacts and forces that caused its velocity, from a rerun window."""
