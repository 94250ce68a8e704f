"""Sources for engines that people use. Each imports its engine when it is first used."""
