"""How agents run: sessions, inboxes, publishers, commands, ticks, health, replay."""
