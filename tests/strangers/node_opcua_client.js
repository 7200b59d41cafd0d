const opcua = require("node-opcua-client");
const { AttributeIds, DataType, MessageSecurityMode, SecurityPolicy, UserTokenType } = opcua;
const tell = (step, value) => console.log(JSON.stringify({ step, value }));
const [url] = process.argv.slice(2);
(async () => {
  const client = opcua.OPCUAClient.create({
    securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy.Basic256Sha256,
    endpointMustExist: false, connectionStrategy: { maxRetry: 1 },
  });
  await client.connect(url);
  const endpoints = await client.getEndpoints();
  tell("endpoints", endpoints.map((one) => [one.securityPolicyUri, one.securityMode]));
  const session = await client.createSession({ type: UserTokenType.UserName, userName: "anna", password: "secret of anna" });
  const node = (text) => `ns=2;s=${text}`;
  const found = await session.browse(node("slave/9/drive"));
  tell("browse", found.references.map((one) => one.browseName.name));
  const level = await session.read({ nodeId: node("slave/8/input/level"), attributeId: AttributeIds.Value });
  tell("read", [level.value.value, DataType[level.value.dataType], level.statusCode.name, level.sourceTimestamp.toISOString()]);
  const subscription = await session.createSubscription2({ requestedPublishingInterval: 100, requestedLifetimeCount: 600,
    requestedMaxKeepAliveCount: 10, maxNotificationsPerPublish: 0, publishingEnabled: true, priority: 0 });
  const item = await subscription.monitor({ nodeId: node("slave/8/input/level"), attributeId: AttributeIds.Value },
    { samplingInterval: 100, queueSize: 10, discardOldest: true }, opcua.TimestampsToReturn.Both);
  item.on("changed", (value) => tell("changed", [value.value.value, value.statusCode.name]));
  const names = ["EventId", "EventType", "SourceName", "Message", "Severity", "Retain", "ActiveState.Id", "AckedState.Id",
    "SourceNode", "ConditionName", "Time", "EnabledState.Id", "ActiveState", "AckedState", "Comment", "ClientUserId"];
  const filter = opcua.constructEventFilter(names, opcua.ofType("ConditionType"));
  filter.selectClauses.push(new opcua.SimpleAttributeOperand({ typeDefinitionId: "ns=0;i=2782", browsePath: [], attributeId: AttributeIds.NodeId }));
  const events = await subscription.monitor({ nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, queueSize: 100, discardOldest: true, filter }, opcua.TimestampsToReturn.Both);
  const all = {}, waiting = [];
  const until = (found) => new Promise((done) => waiting.push([found, done]));
  const look = (event) => waiting.forEach(([found, done]) => found(event) && done());
  const ended = new Promise((done) => {
    events.on("changed", async (fields) => {
      const type = fields[1].value.toString();
      const alarm = fields[6].value !== null;
      const [id, comment] = [fields[16].value && fields[16].value.toString(), fields[14].value && fields[14].value.text];
      tell("event", [type, fields[2].value, fields[3].value && fields[3].value.text, fields[5].value, fields[6].value, fields[7].value, id]);
      if (alarm) all[id] = { eventId: fields[0].value, condition: fields[16].value, severity: fields[4].value,
        source: fields[8].value.toString(), name: fields[9].value, time: fields[10].value instanceof Date, enabled: fields[11].value,
        states: [fields[12].value.text, fields[13].value.text], comment, by: fields[15].value };
      if (alarm) look(all[id]);
      if (type === "ns=0;i=2788") done();
    });
  });
  const other = await session.createSubscription2({ requestedPublishingInterval: 100, requestedLifetimeCount: 600,
    requestedMaxKeepAliveCount: 10, maxNotificationsPerPublish: 0, publishingEnabled: true, priority: 0 });
  const beside = await other.monitor({ nodeId: "i=2253", attributeId: AttributeIds.EventNotifier },
    { samplingInterval: 0, queueSize: 100, discardOldest: true, filter }, opcua.TimestampsToReturn.Both);
  beside.on("changed", (fields) => tell("beside", fields[14].value && fields[14].value.text));
  await new Promise((done) => setTimeout(done, 300));
  tell("refresh", (await session.call({ objectId: "i=2782", methodId: "i=3875",
    inputArguments: [{ dataType: DataType.UInt32, value: subscription.subscriptionId }] })).statusCode.name);
  await ended;
  const last = all["ns=2;s=condition/slave/9/drive/faults/over temperature"];
  tell("fields", [last.severity, last.source, last.name, last.time, last.enabled, last.states]);
  const acked = until((event) => event.states[1] === "Acknowledged");
  tell("unknown event", (await session.acknowledgeCondition(last.condition, Buffer.from("x"), "seen")).name);
  tell("acknowledge", (await session.acknowledgeCondition(last.condition, last.eventId, "seen")).name);
  await acked;
  tell("acked", [all[last.condition.toString()].states[1], all[last.condition.toString()].comment, all[last.condition.toString()].by]);
  tell("again", (await session.acknowledgeCondition(last.condition, last.eventId, "seen")).name);
  tell("confirm", (await session.confirmCondition(last.condition, last.eventId, "seen")).name);
  const commented = until((event) => event.comment === "mended");
  // its own addCommentCondition() looks for a node of the condition, which there need not be
  tell("comment", (await session.call({ objectId: last.condition, methodId: "i=9029", inputArguments: [
    { dataType: DataType.ByteString, value: last.eventId }, { dataType: DataType.LocalizedText, value: { text: "mended" } }] })).statusCode.name);
  await commented;
  tell("refresh of another", (await session.call({ objectId: "i=2782", methodId: "i=3875",
    inputArguments: [{ dataType: DataType.UInt32, value: 4711 }] })).statusCode.name);
  const write = async (text, dataType, value) =>
    (await session.write({ nodeId: node(text), attributeId: AttributeIds.Value, value: { value: { dataType, value } } })).name;
  tell("write lamp", await write("slave/8/output/lamp", DataType.Boolean, true));
  tell("write horn", await write("slave/8/output/horn", DataType.Boolean, true));
  tell("write type", await write("slave/8/output/lamp", DataType.UInt16, 1));
  tell("write refused", await write("slave/8/output/flow", DataType.UInt16, 4000));
  tell("reason", (await session.read({ nodeId: node("last/Reason") })).value.value);
  const old = await session.write({ nodeId: node("slave/8/output/lamp"), attributeId: AttributeIds.Value,
    value: { value: { dataType: DataType.Boolean, value: false }, sourceTimestamp: new Date(Date.now() - 60000) } });
  tell("write old", old.name);
  tell("lamp", (await session.read({ nodeId: node("slave/8/output/lamp"), attributeId: AttributeIds.Value })).value.value);
  const call = async (word, args) => (await session.call({ objectId: node("slave/9/drive"),
    methodId: node(`slave/9/drive/method/${word}`), inputArguments: args || [] })).statusCode.name;
  tell("stop", await call("stop"));
  tell("coast", await call("coast"));
  tell("speed", await call("speed", [{ dataType: DataType.Double, value: 0.5 }]));
  const history = await session.readHistoryValue({ nodeId: node("slave/8/input/level") }, new Date(0), new Date());
  tell("history", [history.statusCode.name, history.historyData.dataValues.map((one) => [one.value && one.value.value, one.statusCode.name])]);
  const pages = [];
  let point = null;
  do {
    const answer = await session.historyRead(new opcua.HistoryReadRequest({
      historyReadDetails: new opcua.ReadRawModifiedDetails({ isReadModified: false, startTime: new Date(0), endTime: new Date(),
        numValuesPerNode: 2, returnBounds: true }),
      nodesToRead: [{ nodeId: node("slave/8/input/level"), continuationPoint: point }],
      releaseContinuationPoints: false, timestampsToReturn: opcua.TimestampsToReturn.Both }));
    const [page] = answer.results;
    pages.push(page.historyData.dataValues.map((one) => one.statusCode.name));
    point = page.continuationPoint;
  } while (point && point.length && pages.length < 9);
  tell("pages", pages);
  await subscription.terminate();
  await session.close();
  let refused = "";
  try { await client.createSession({ type: UserTokenType.UserName, userName: "anna", password: "wrong" }); } catch (error) { refused = error.message; }
  tell("wrong password", /BadUserAccessDenied|BadIdentityTokenRejected/.test(refused));
  const anonymous = await client.createSession();
  const denied = await anonymous.write({ nodeId: node("slave/8/output/lamp"), attributeId: AttributeIds.Value,
    value: { value: { dataType: DataType.Boolean, value: true } } });
  tell("anonymous", denied.name);
  await anonymous.close();
  await client.disconnect();
  const open = opcua.OPCUAClient.create({ securityMode: MessageSecurityMode.None, securityPolicy: SecurityPolicy.None,
    endpointMustExist: false, connectionStrategy: { maxRetry: 0 } });
  let why = "connected";
  try { await open.connect(url); await open.createSession(); } catch (error) { why = "refused"; }
  tell("without security", why);
  await open.disconnect().catch(() => {});
  process.exit(0);
})().catch((error) => { console.error(error); process.exit(1); });
