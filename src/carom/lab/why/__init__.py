"""Why a body moves as it does: the impacts, contacts and forces behind it, found by running a window again."""
