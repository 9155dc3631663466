"""The BOPTEST gateway: BOPTEST's REST interface to any scenario.

It requires FastAPI and uvicorn (the extra `boptest`).
"""
