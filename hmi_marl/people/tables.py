"""Tables of the database of people, by the statements that make them."""

SCHEMA = 1
"""Version of the tables."""
TABLES = {
    "visitors": """CREATE TABLE visitors (
        number INTEGER PRIMARY KEY AUTOINCREMENT, code TEXT NOT NULL UNIQUE, made TEXT NOT NULL)""",
    "sessions": """CREATE TABLE sessions (
        id TEXT PRIMARY KEY, visitor INTEGER NOT NULL REFERENCES visitors ON DELETE CASCADE,
        kind TEXT NOT NULL, state TEXT NOT NULL, made TEXT NOT NULL)""",
    "trips": """CREATE TABLE trips (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        session TEXT NOT NULL REFERENCES sessions ON DELETE CASCADE, head TEXT NOT NULL,
        seen INTEGER NOT NULL, crashed INTEGER NOT NULL, digest TEXT NOT NULL,
        finished INTEGER NOT NULL)""",
    "decisions": """CREATE TABLE decisions (
        trip INTEGER NOT NULL REFERENCES trips ON DELETE CASCADE, step INTEGER NOT NULL,
        intent INTEGER NOT NULL, alert INTEGER NOT NULL, away INTEGER,
        PRIMARY KEY (trip, step)) WITHOUT ROWID""",
    "answers": """CREATE TABLE answers (
        session TEXT NOT NULL REFERENCES sessions ON DELETE CASCADE, question TEXT NOT NULL,
        value TEXT NOT NULL, made TEXT NOT NULL, PRIMARY KEY (session, question)) WITHOUT ROWID""",
    "sessions_of": "CREATE INDEX sessions_of ON sessions (visitor)",
    "trips_of": "CREATE INDEX trips_of ON trips (session)",
}
OF_VISITOR = {
    "visitors": "visitors WHERE number = ?",
    "sessions": "sessions WHERE visitor = ?",
    "trips": "trips JOIN sessions ON sessions.id = session WHERE visitor = ?",
    "decisions": "decisions JOIN trips ON trips.number = trip "
    "JOIN sessions ON sessions.id = session WHERE visitor = ?",
    "answers": "answers JOIN sessions ON sessions.id = session WHERE visitor = ?",
}
"""Rows of a visitor in each table, as the end of a SELECT."""
