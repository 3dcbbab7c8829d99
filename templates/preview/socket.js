// The host of the page of `thorvaldc preview`: its server.

const RETRY = 1000; // ms
let socket = null;

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function connect() {
  socket = new WebSocket(location.href.replace(/^http/, "ws").replace(/[?#].*$/, "") + "socket");
  socket.onmessage = (event) => {
    const received = wallClock(), message = JSON.parse(event.data);
    receivers[message.kind]?.(message, received);
  };
  socket.onclose = () => {
    drive.switched({ on: false, message: "" });
    status("not connected: start `thorvaldc preview` again", true);
    viewer.setGrey(true);
    setTimeout(connect, RETRY);
  };
}
connect();
