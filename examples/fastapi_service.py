"""An HTTP service over a bus with FastAPI: values and states to read, outputs and drive orders to send.

Start it with ``python examples/fastapi_service.py`` on a simulated plant, or with
``python examples/fastapi_service.py /dev/ttyUSB0`` on a real bus; then open http://127.0.0.1:8000/docs in a browser.

Whoever reaches the port may start drives: it listens on this computer only. When the server ends, so does the bus:
safe values, Clear, out of the token ring.
"""

import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Literal

import dpstack

try:
    import uvicorn
    from fastapi import Body, FastAPI, Request
    from fastapi.responses import JSONResponse
except ImportError:
    raise SystemExit("this example needs FastAPI and uvicorn: pip install fastapi uvicorn") from None

PLANT = Path(__file__).with_name("plant.toml")
Value = bool | int | float


def service(port: str | None = None) -> FastAPI:
    """The application; the bus of plant.toml is open while the server runs. ``port`` in place of that in the file."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with dpstack.open_bus(PLANT, port=port) as bus:
            await bus.operate()
            app.state.bus = bus
            yield

    app = FastAPI(title="plant", lifespan=lifespan)

    def bus_of(request: Request) -> dpstack.Bus:
        bus = request.app.state.bus
        assert isinstance(bus, dpstack.Bus)
        return bus

    @app.get("/slaves")
    async def slaves(request: Request) -> list[dict[str, object]]:
        """Each slave with its state; values only while they are valid."""
        return [
            {
                "name": slave.name,
                "address": slave.address,
                "state": slave.state.value,
                "inputs": shown(slave.input_values) if slave.inputs_valid else None,
                "fault": slave.fault.text if slave.fault else None,
            }
            for slave in bus_of(request).slaves
        ]

    @app.put("/slaves/{name}/outputs")
    async def set_outputs(request: Request, name: str, values: dict[str, Value]) -> dict[str, object]:
        """Named outputs, all in one telegram; the others stay as they are."""
        slave = bus_of(request).slave(name)
        slave.update(values)
        return shown(slave.output_values)

    @app.get("/drives/{name}")
    async def drive(request: Request, name: str) -> dict[str, object]:
        return bus_of(request).drive(name).status.as_dict()

    @app.put("/drives/{name}/speed")
    async def speed(request: Request, name: str, fraction: float = Body(embed=True)) -> dict[str, object]:
        """A part of the reference speed: 0.5 is 50 %."""
        drive = bus_of(request).drive(name)
        drive.speed = fraction
        return {"setpoint": drive.speed}

    @app.post("/drives/{name}/{order}")
    async def order(
        request: Request, name: str, order: Literal["start", "stop", "quick_stop", "acknowledge"]
    ) -> dict[str, object]:
        """Answers once the drive has carried out the order."""
        drive = bus_of(request).drive(name)
        orders = {
            "start": drive.start,
            "stop": drive.stop,
            "quick_stop": drive.quick_stop,
            "acknowledge": drive.acknowledge,
        }
        await orders[order]()
        return drive.status.as_dict()

    @app.exception_handler(dpstack.DpError)
    async def refused(request: Request, error: Exception) -> JSONResponse:
        """409: the plant does not allow it at this moment; 422: the request is wrong; 503: the bus has ended."""
        code = 422 if isinstance(error, dpstack.UsageError) else 503 if isinstance(error, dpstack.BusError) else 409
        return JSONResponse({"detail": str(error)}, status_code=code)

    return app


def shown(values: dict[str, bool | int | float | bytes]) -> dict[str, object]:
    """Octets as hex: JSON has none."""
    return {name: value.hex(" ") if isinstance(value, bytes) else value for name, value in values.items()}


if __name__ == "__main__":
    uvicorn.run(service(sys.argv[1] if len(sys.argv) > 1 else None), host="127.0.0.1", port=8000)
