"""Why a body moves as it does: the impacts, contacts and forces behind it, from a window that is run again."""
